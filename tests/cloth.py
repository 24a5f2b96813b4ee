"""A small sheet that folds, and what its receivers see of it."""

from __future__ import annotations

import numpy as np

from prtnet.patches import PatchSurroundings
from prtnet.scene import PointCacheScene, Receivers
from prtnet.tangents import rest_tangents
from tests.data_gen.meshes import cache
from training.patch_fit import fit_patches


def sheet_faces(width: int, height: int) -> np.ndarray:
    """Triangles of a grid, counter-clockwise from above where x goes right and z towards us."""
    corner = np.arange(width * height).reshape(height, width)
    up, down = corner[:-1], corner[1:]
    a, b, c, d = (part.ravel() for part in (up[:, :-1], down[:, :-1], down[:, 1:], up[:, 1:]))
    return np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.int32)


def folding_sheet(width: int = 12, height: int = 9, frames: int = 4) -> PointCacheScene:
    """Flat at first, then rolled up more and more and waving."""
    x, z = np.meshgrid(np.linspace(0, 1.2, width), np.linspace(0, 0.9, height))
    bend = np.linspace(0.01, 4.0, frames)[:, None, None]
    angle = bend * x
    motion = [np.sin(angle) / bend, (1 - np.cos(angle)) / bend, np.broadcast_to(z, angle.shape)]
    motion[1] = motion[1] + 0.05 * bend * np.sin(9 * z + x)
    points = np.stack(motion, axis=-1).reshape(frames, -1, 3)
    return cache(points.astype(np.float32), sheet_faces(width, height))


def surroundings_of(
    scene: PointCacheScene, two_sided: bool = True, **options: object
) -> tuple[PatchSurroundings, Receivers, np.ndarray]:
    """Fitted surroundings, the receivers and their tangents at rest."""
    receivers = scene.receivers(two_sided)
    tangents = rest_tangents(scene, receivers)
    options = {"levels": (3, 10, 30), "rings": 2, **options}
    fitted = fit_patches(
        scene.faces, receivers.of_vertex, scene.frames[0], tangents, two_sided, **options
    )
    return fitted, receivers, tangents
