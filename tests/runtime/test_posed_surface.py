from __future__ import annotations

import numpy as np
import pytest

from data_gen.procedural import arm
from prtnet.errors import PrtnetError
from prtnet.frames import rest_tangents
from prtnet.modelled_scene import ModelledScene, Moment
from prtnet.scene import SkinnedScene
from runtime.posed_surface import coloured_surface, posed_subject
from runtime.shading import world_transfer
from tests.models import random_model


def modelled(scene: SkinnedScene, two_sided: bool, lobes: int = 0, order: int = 3) -> ModelledScene:
    receivers = scene.receivers(two_sided)
    model = random_model(
        joints=scene.joint_count, receivers=len(receivers), lobes=lobes, order=order
    )
    model.rest_tangents[:] = rest_tangents(scene, receivers)
    model.metadata.update(mesh_sha256=scene.mesh_sha256, two_sided=two_sided)
    return ModelledScene(model, scene)


def axis(transfer: np.ndarray) -> np.ndarray:
    """The axis of the linear band, unit: (−f₁₁, −f₁₋₁, f₁₀)."""
    vector = np.stack([-transfer[:, 3], -transfer[:, 1], transfer[:, 2]], axis=1)
    return vector / np.linalg.norm(vector, axis=1, keepdims=True)


@pytest.mark.parametrize("two_sided", [False, True])
def test_open_vertices_face_along_their_normals(two_sided: bool) -> None:
    """Where nothing is hidden the transfer is the clamped cosine about the vertex's own normal."""
    scene = arm(segments=6)
    actor = modelled(scene, two_sided)
    pose = actor.poses("bend", np.array([1.5]))
    visibility = np.zeros((len(actor.receivers), 9), dtype=np.float32)
    visibility[:, 0] = np.sqrt(4 * np.pi)
    subject = posed_subject(actor, pose, visibility)
    geometry = scene.geometry(pose)
    assert np.array_equal(subject.positions, geometry.positions[0])
    facing = [axis(world_transfer(side.visibility, side.frames)) for side in subject.sides]
    assert facing[0] == pytest.approx(geometry.normals[0], abs=1e-5)
    assert len(facing) == 1 + two_sided
    if two_sided:
        assert facing[1] == pytest.approx(-geometry.normals[0], abs=1e-5)


@pytest.mark.parametrize("two_sided", [False, True])
def test_colours_of_receivers_are_on_their_vertices(two_sided: bool) -> None:
    scene = arm(segments=6)
    actor = modelled(scene, two_sided)
    pose = actor.poses("bend", np.array([1.5]))
    # A receiver's colour is where it is, its blue which side that is of.
    places = actor.geometry(pose).positions[0].copy()
    places[:, 2] = actor.receivers.side
    surface = coloured_surface(actor, scene.geometry(pose).positions[0], places)
    positions = scene.geometry(pose).positions[0]
    assert surface.transfer[:, :2] == pytest.approx(positions[:, :2], abs=1e-6)
    assert (surface.transfer[:, 2] == 1).all()
    assert (surface.back_transfer is not None) == two_sided
    if surface.back_transfer is not None:
        assert surface.back_transfer[:, :2] == pytest.approx(positions[:, :2], abs=1e-6)
        assert (surface.back_transfer[:, 2] == -1).all()


def test_limbs_keep_their_lengths_on_the_way_between_poses() -> None:
    """A straight line between matrices would make them short and thin."""
    scene = arm(segments=6)
    actor = modelled(scene, two_sided=False)
    ends = Moment("bend", 0.0), Moment("bend", 2.0)
    whole = [actor.poses(*end[:1], np.array([end.time])) for end in ends]
    between = actor.blended(*ends, 0.5)
    matrices = scene.joint_matrices(np.concatenate([whole[0], between, whole[1]])).astype(float)
    size = np.linalg.det(matrices[..., :3])
    np.testing.assert_allclose(size, size[:1].repeat(3, axis=0), rtol=1e-5)
    assert np.abs(matrices[1] - 0.5 * (matrices[0] + matrices[2])).max() > 0.05
    for share, end in zip((0.0, 1.0), whole, strict=True):
        np.testing.assert_allclose(actor.blended(*ends, share), end, atol=1e-6)
    with pytest.raises(PrtnetError, match="runs from 0 to 4 s"):
        actor.blended(ends[0], Moment("bend", 9.0), 0.5)
    with pytest.raises(PrtnetError, match="has no clip"):
        actor.blended(Moment("bnd", 0.0), ends[1], 0.5)
