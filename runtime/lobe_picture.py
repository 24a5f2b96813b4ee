"""A field on a posed mesh: lobes at its vertices, or a patch laid on it as a texture.

In NumPy: shades vertices or pixels with the reference of ``runtime.lobe_shading``. A picture is
drawn strip by strip and shaded block by block, so that memory does not grow with it.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from prtnet.arrays import FloatArray
from prtnet.canvas import Canvas
from prtnet.frames import orthonormal_frames
from prtnet.lobe_field import LobeField
from prtnet.scene import unit
from prtnet.transfer import Patch, TransferField, wrapped
from prtnet.zh import Lobes, LobesApart
from runtime.lobe_shading import LobeLight, rows_radiance, seen_in, view_factors
from runtime.rasteriser import rasterise

__all__ = ["drawn_by_numpy", "sampled", "strip_rows", "strips_by_numpy"]

LEAST = 1e-6  # length of an interpolated axis
STRIP = 1 << 19  # pixels of a picture at a time
BLOCK = 1 << 14  # of those that are shaded


def drawn_by_numpy(
    field: LobeField | TransferField,
    canvas: Canvas,
    light: LobeLight,
    eye: FloatArray,
    matrix: FloatArray,
    size: tuple[int, int],
) -> FloatArray:
    """A picture of one sample a pixel, as ``runtime.rasteriser.rasterise`` gives it.

    Args:
        field: of a patch or of the mesh itself; full transfer is turned exactly.
        canvas: where it is.
        light: of the field's order.
        eye: where from, (3,).
        matrix: world to clip space, (4, 4).
        size: width and height in pixels.

    Returns:
        (H, W, 4) float32, top row first. The back of a patch bulges as its front does.
    """
    step = strip_rows(size)
    strips = strips_by_numpy(field, canvas, light, eye, matrix, size, step)
    return np.concatenate(list(strips))


def strip_rows(size: tuple[int, int], scale: int = 1) -> int:
    """Rows of a strip of a picture (W, H): a multiple of ``scale``, and at least that."""
    return max(1, STRIP // (size[0] * scale)) * scale


def strips_by_numpy(
    field: LobeField | TransferField,
    canvas: Canvas,
    light: LobeLight,
    eye: FloatArray,
    matrix: FloatArray,
    size: tuple[int, int],
    step: int,
) -> Iterator[FloatArray]:
    """The same picture, ``step`` rows at a time from the top."""
    ends = [(top, min(top + step, size[1])) for top in range(0, size[1], step)]
    if canvas.places is None:
        colours = vertex_radiance(field, canvas, light, eye)
        for rows in ends:
            yield rasterise(canvas.positions, canvas.faces, colours, matrix, size, rows=rows)
        return
    parts = [canvas.positions, canvas.tangents, canvas.normals, canvas.places]
    front, back = (
        np.concatenate([*parts, np.full((len(canvas.positions), 1), side)], axis=1)
        for side in (1.0, -1.0)
    )
    for rows in ends:
        seen = rasterise(canvas.positions, canvas.faces, front, matrix, size, back, rows)
        result = np.zeros((*seen.shape[:2], 4), dtype=np.float32)
        line, column = np.nonzero(seen[..., -1] > 0)
        for start in range(0, len(line), BLOCK):
            block = line[start : start + BLOCK], column[start : start + BLOCK]
            result[(*block, slice(3))] = pixel_radiance(field, seen[block], light, eye)
        result[line, column, 3] = 1.0
        yield result


def vertex_radiance(
    field: LobeField | TransferField, canvas: Canvas, light: LobeLight, eye: FloatArray
) -> FloatArray:
    """Of vertices with transfer of their own, (V, 3)."""
    frames = canvas.frames
    points = field.lobes if isinstance(field, LobeField) else field.transfer
    rows = rows_radiance(points, frames, light)
    if field.view is None:
        return seen_in(rows, None)
    view = unit(eye - canvas.positions)
    local = np.einsum("pij,pi->pj", frames, view)
    return seen_in(rows, view_factors(field.view, local))


def pixel_radiance(
    field: LobeField | TransferField, seen: FloatArray, light: LobeLight, eye: FloatArray
) -> FloatArray:
    """Of pixels, (P, 3): position, tangent, normal, place and side, interpolated, (P, 12+)."""
    position, tangent, normal = (seen[:, 3 * k : 3 * k + 3] for k in range(3))
    frames = orthonormal_frames(tangent, normal)
    frames[..., 2] *= seen[:, 11, None]
    rows = rows_radiance(sampled(field, seen[:, 9:11]), frames, light)
    if field.view is None:
        return seen_in(rows, None)
    assert isinstance(field.layout, Patch)
    view = np.einsum("pij,pi->pj", frames, unit(eye - position))  # in the patch's frame
    height, width = field.layout.heights.shape
    normals = bilinear(field.layout.normals.reshape(height, width, 3), seen[:, 9:11], field.layout)
    relief = orthonormal_frames(np.broadcast_to([1.0, 0.0, 0.0], normals.shape), normals)
    local = np.einsum("pij,pi->pj", relief, view)
    return seen_in(rows, view_factors(field.view, local))


def sampled(field: LobeField | TransferField, places: FloatArray) -> LobesApart | FloatArray:
    """A patch's lobes (P, R, N) or transfer (P, R, n²) at places (P, 2).

    The lowest bands, full transfer and coherent lobes are interpolated, others those of the texel.
    """
    layout = field.layout
    assert isinstance(layout, Patch)
    shape = layout.heights.shape
    if isinstance(field, TransferField):
        return bilinear(field.transfer.reshape(*shape, *field.transfer.shape[1:]), places, layout)
    axes, coefficients, low = (
        part.reshape(*shape, *part.shape[1:])
        for part in (field.axes, field.coefficients, field.low)
    )
    at = bilinear if field.coherent else nearest
    turned = at(axes, places, layout)
    length = np.maximum(np.linalg.norm(turned, axis=-1, keepdims=True), LEAST)
    return LobesApart(
        bilinear(low, places, layout), Lobes(turned / length, at(coefficients, places, layout))
    )


def nearest(texels: FloatArray, places: FloatArray, layout: Patch) -> FloatArray:
    """Texels (H, W, …) at places (P, 2): (P, …)."""
    height, width = texels.shape[:2]
    column, row = (np.floor(places[:, k] * n).astype(int) for k, n in ((0, width), (1, height)))
    across, along = layout.tiles
    return np.asarray(texels[wrapped(row, height, along), wrapped(column, width, across)])


def bilinear(texels: FloatArray, places: FloatArray, layout: Patch) -> FloatArray:
    """Between the middles of texels (H, W, …) at places (P, 2): (P, …)."""
    height, width = texels.shape[:2]
    x, y = (places[:, k].astype(np.float64) * n - 0.5 for k, n in ((0, width), (1, height)))
    left, below = np.floor(x).astype(int), np.floor(y).astype(int)
    across, along = layout.tiles
    total = np.zeros((len(places), *texels.shape[2:]))
    for up in (0, 1):
        for right in (0, 1):
            weight = np.abs(1 - right - (x - left)) * np.abs(1 - up - (y - below))
            row, column = wrapped(below + up, height, along), wrapped(left + right, width, across)
            total += weight.reshape(-1, *[1] * (texels.ndim - 2)) * texels[row, column]
    return total
