"""Which vertex is under the mouse."""

from __future__ import annotations

import numpy as np

from prtnet.arrays import FloatArray, IntArray

__all__ = ["picked", "projected"]


def projected(points: FloatArray, matrix: FloatArray, size: tuple[int, int]) -> FloatArray:
    """Pixels from the left and from the top, and clip w (the distance along the view), (V, 3).

    Args:
        points: world space, (V, 3).
        matrix: world to clip space, (4, 4), as ``Camera.matrix``.
        size: width and height in pixels.
    """
    clip = np.asarray(points, dtype=np.float64) @ matrix[:, :3].T + matrix[:, 3]
    w = np.where(clip[:, 3] == 0.0, 1e-12, clip[:, 3])
    place = clip[:, :2] / w[:, None]
    return np.column_stack(
        [(0.5 + 0.5 * place[:, 0]) * size[0], (0.5 - 0.5 * place[:, 1]) * size[1], clip[:, 3]]
    )


def picked(
    positions: FloatArray,
    faces: IntArray,
    matrix: FloatArray,
    size: tuple[int, int],
    place: tuple[float, float],
) -> tuple[int, bool] | None:
    """The vertex that is seen at a place of a picture: the nearest corner of the triangle there.

    Triangles that reach behind the eye are left out.

    Args:
        positions: vertices, (V, 3).
        faces: triangles, (T, 3), counter-clockwise from the front.
        matrix: world to clip space, (4, 4), as ``Camera.matrix``.
        size: width and height in pixels.
        place: pixels from the left and from the top; the middle of the first is (0.5, 0.5).

    Returns:
        The vertex, and whether its back is seen; None where nothing is.
    """
    screen = projected(positions, matrix, size)
    corners = screen[faces]  # [T, 3, 3]
    edges = corners[..., :2] - np.asarray(place)
    across = np.roll(edges, -1, axis=1)
    # Twice the areas of the three triangles that the place makes with the edges: of one sign
    # inside. Of edge 0 to 1 it is corner 2's share.
    area = edges[..., 0] * across[..., 1] - edges[..., 1] * across[..., 0]
    whole = area.sum(axis=1)
    inside = ((area >= 0).all(axis=1) | (area <= 0).all(axis=1)) & (whole != 0.0)
    found = np.flatnonzero(inside & (corners[..., 2] > 0).all(axis=1))
    if not len(found):
        return None
    share = np.roll(area[found], -1, axis=1) / whole[found, None]  # by corner
    # 1/w is linear on the screen.
    nearness = (share / corners[found, :, 2]).sum(axis=1)
    face = found[nearness.argmax()]
    nearest = np.square(edges[face]).sum(axis=1).argmin()
    # The picture's y points down: what is counter-clockwise in space is clockwise in it.
    return int(faces[face, nearest]), bool(whole[face] > 0.0)
