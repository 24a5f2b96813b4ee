from __future__ import annotations

import numpy as np
import pytest

from data_gen.procedural import arm
from prtnet.frames import rest_tangents
from prtnet.modelled_scene import ModelledScene
from prtnet.scene import SkinnedScene
from runtime.posed_surface import posed_surface
from tests.models import random_model


def modelled(scene: SkinnedScene, two_sided: bool) -> ModelledScene:
    receivers = scene.receivers(two_sided)
    model = random_model(joints=scene.joint_count, receivers=len(receivers))
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
    surface = posed_surface(actor, pose, visibility)
    geometry = scene.geometry(pose)
    assert np.array_equal(surface.positions, geometry.positions[0])
    assert axis(surface.transfer) == pytest.approx(geometry.normals[0], abs=1e-5)
    if two_sided:
        assert surface.back_transfer is not None
        assert axis(surface.back_transfer) == pytest.approx(-geometry.normals[0], abs=1e-5)
    else:
        assert surface.back_transfer is None
