"""A posed scene with visibility on its receivers, as the renderers take it."""

from __future__ import annotations

import dataclasses

import numpy as np

from prtnet.arrays import FloatArray, IntArray
from prtnet.dataset import Dataset
from prtnet.frames import orthonormal_frames
from prtnet.modelled_scene import ModelledScene
from prtnet.zh import Lobes
from runtime.one_dimensional import LobeSide, LobeSubject
from runtime.reflected import Side, Subject
from runtime.shading import Surface, world_transfer

__all__ = [
    "coloured_surface",
    "lobed_subject",
    "posed_subject",
    "recorded_surface",
    "seeing",
    "sides",
]


def posed_subject(
    actor: ModelledScene, pose: FloatArray, visibility: FloatArray | None = None
) -> Subject:
    """The render mesh in one pose, with visibility and frames on its vertices, for any material.

    Args:
        actor: the scene and its receivers.
        pose: flattened, (1, D).
        visibility: local frames, (V, n²); sides have none when not given.
    """
    mesh = actor.scene.geometry(pose)
    frames = actor.frame_field.frames(pose, actor.receivers.gather(mesh))[0]
    none = np.zeros((len(frames), 0), dtype=np.float32)
    front, back = sides(actor)
    bare = Subject(
        mesh.positions[0],
        actor.scene.faces,
        Side(none[front], frames[front]),
        None if back is None else Side(none[back], frames[back]),
    )
    return bare if visibility is None else seeing(actor, bare, visibility)


def seeing(actor: ModelledScene, subject: Subject, visibility: FloatArray) -> Subject:
    """The same pose with other visibility of receivers (V, n²)."""
    own = zip(sides(actor), (subject.front, subject.back), strict=True)
    front, back = (
        None if side is None or receivers is None else Side(visibility[receivers], side.frames)
        for receivers, side in own
    )
    assert front is not None
    return dataclasses.replace(subject, front=front, back=back)


def lobed_subject(actor: ModelledScene, subject: Subject, lobes: Lobes) -> LobeSubject:
    """The same pose with visibility of receivers as lobes, axes (V, c, 3)."""
    front, back = (
        None if side is None else LobeSide(lobes[receivers], side.frames)
        for receivers, side in zip(sides(actor), (subject.front, subject.back), strict=True)
    )
    assert front is not None
    return LobeSubject(subject.positions, subject.faces, front, back)


def coloured_surface(actor: ModelledScene, positions: FloatArray, colours: FloatArray) -> Surface:
    """The render mesh with a colour (V, 3) of every receiver.

    Its transfer is that colour: see ``runtime.draw.render_colours``.

    Args:
        actor: the scene and its receivers.
        positions: of render vertices, (V_render, 3).
        colours: linear RGB.
    """
    front, back = sides(actor)
    return Surface(
        positions, actor.scene.faces, colours[front], None if back is None else colours[back]
    )


def sides(actor: ModelledScene) -> tuple[IntArray, IntArray | None]:
    """Receivers of every vertex's front, and of its back where the model has one."""
    vertex = actor.receivers.of_vertex
    backs = int((actor.receivers.side < 0).sum())  # as many as fronts, or none
    return vertex, vertex + backs if backs else None


def recorded_surface(dataset: Dataset, row: int, visibility: FloatArray) -> Surface:
    """One pose of a dataset, without its scene: triangles over front receivers.

    Args:
        dataset: holds the posed receivers.
        row: the pose.
        visibility: local frames, (V, n²).
    """
    frames = orthonormal_frames(dataset.read("tangents", row), dataset.read("normals", row))
    transfer = world_transfer(visibility, frames)
    fronts = int((dataset.receiver_side > 0).sum())
    return Surface(
        positions=dataset.read("positions", row)[:fronts],
        faces=dataset.receiver_of_vertex[dataset.faces],
        transfer=transfer[:fronts],
        back_transfer=transfer[fronts:] if fronts < len(transfer) else None,
    )
