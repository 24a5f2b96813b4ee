"""A posed scene with visibility on its receivers, as the renderers take it."""

from __future__ import annotations

from prtnet.arrays import FloatArray
from prtnet.dataset import Dataset
from prtnet.frames import orthonormal_frames
from prtnet.modelled_scene import ModelledScene
from runtime.shading import Surface, world_transfer

__all__ = ["posed_surface", "recorded_surface"]


def posed_surface(actor: ModelledScene, pose: FloatArray, visibility: FloatArray) -> Surface:
    """The render mesh in one pose, with the transfer of its receivers on its vertices.

    Args:
        actor: the scene and its receivers.
        pose: flattened, (1, D).
        visibility: local frames, (V, n²).
    """
    transfer = world_transfer(visibility, actor.frames(pose)[0])
    vertex = actor.receivers.of_vertex
    backs = int((actor.receivers.side < 0).sum())  # as many as fronts, or none
    return Surface(
        positions=actor.scene.geometry(pose).positions[0],
        faces=actor.scene.faces,
        transfer=transfer[vertex],
        back_transfer=transfer[vertex + backs] if backs else None,
    )


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
