"""A posed scene with visibility on its receivers, as the renderers take it."""

from __future__ import annotations

from prtnet.arrays import FloatArray
from prtnet.modelled_scene import ModelledScene
from runtime.shading import Surface, world_transfer

__all__ = ["posed_surface"]


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
