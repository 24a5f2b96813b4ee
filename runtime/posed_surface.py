"""A posed scene with visibility on its receivers, as the renderers take it."""

from __future__ import annotations

import numpy as np

from prtnet.arrays import FloatArray, IntArray
from prtnet.dataset import Dataset
from prtnet.frames import orthonormal_frames
from prtnet.modelled_scene import ModelledScene
from runtime.reflected import Side, Subject
from runtime.shading import Surface, world_transfer

__all__ = ["coloured_surface", "posed_subject", "recorded_surface", "sides"]


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
    if visibility is None:
        visibility = np.zeros((len(frames), 0), dtype=np.float32)
    front, back = sides(actor)
    return Subject(
        mesh.positions[0],
        actor.scene.faces,
        Side(visibility[front], frames[front]),
        None if back is None else Side(visibility[back], frames[back]),
    )


def coloured_surface(actor: ModelledScene, pose: FloatArray, colours: FloatArray) -> Surface:
    """The render mesh in one pose, with a colour (V, 3) of every receiver.

    Its transfer is that colour: see ``runtime.draw.render_colours``.
    """
    front, back = sides(actor)
    return Surface(
        actor.scene.geometry(pose).positions[0],
        actor.scene.faces,
        colours[front],
        None if back is None else colours[back],
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
