"""A light that turns, as a cube map of every moment: from a table that was smoothed once.

A light smaller than the distance between the samples of a cube map would flicker as it turns
("All-Frequency", Liu, Sloan, Shum and Snyder 2004, section 6 warns of aliasing). The table holds
the light spread by heat over the sphere, to a Gaussian about as wide as that distance: however it
is turned, the samples see the same of it. Heat keeps the light's energy, and a constant light as
it is. Every turn looks it up anew, on torch's threads.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import scipy.sparse
import torch
from torch.nn.functional import embedding_bag

from prtnet.arrays import FloatArray
from prtnet.cube_map import SIZE, directions, solid_angles
from prtnet.environment import Environment, Source
from prtnet.equirectangular import Picture
from prtnet.laplacian import cotangent_laplacian
from prtnet.octahedral import Grid, grid_of, looked_up
from prtnet.sh_rotation import checked_rotation

__all__ = ["TurningLight"]

SPREAD = 0.7  # of the distance of samples: less flickers, more blurs
CELLS = 5  # of the table, a side, for every sample along a face
ROWS = 1.6  # in which a light is sampled at least, for every cell along a side
BLOCK = 1 << 18  # directions that a light is asked for at a time


class TurningLight:
    """A light as a cube map, whatever its rotation.

    Args:
        light: a source, or a turned one.
        size: texels n a side of a face.
        samples: of a texel, a side.
    """

    def __init__(self, light: Source | Environment, size: int = SIZE, samples: int = 4) -> None:
        self.size = size
        self.cells = CELLS * size * samples
        grid = grid_of(self.cells)
        spread = SPREAD * 2.0 / (size * samples)  # samples are farthest apart amid a face
        falls = gathered(light, grid, self.cells)
        self.table = torch.from_numpy(warmed(falls, self.cells, spread)[grid.vertex])
        fine = directions(size * samples).reshape(6, size, samples, size, samples, 3)
        share = solid_angles(size * samples).reshape(size, samples, size, samples)
        shares = np.broadcast_to(share / share.sum(axis=(1, 3), keepdims=True), fine.shape[:-1])
        self.directions = torch.from_numpy(
            fine.transpose(5, 0, 1, 3, 2, 4).reshape(3, -1).astype(np.float32)
        )
        self.shares = torch.from_numpy(
            shares.transpose(0, 1, 3, 2, 4).reshape(-1).astype(np.float32)
        )
        self.starts = torch.arange(0, len(self.shares), samples**2, dtype=torch.int32)

    def at(self, rotation: FloatArray | None = None) -> FloatArray:
        """The cube map (6, n, n, 3) float32, linear RGB, of the light turned.

        Args:
            rotation: R (3, 3): what was in direction R⁻¹ s is in direction s.

        Raises:
            ValueError: it is no rotation.
        """
        back = np.eye(3) if rotation is None else np.asarray(checked_rotation(rotation)).T
        where = torch.from_numpy(back.astype(np.float32)) @ self.directions
        found = torch.zeros((len(self.starts), 3))
        for corner, weight in zip(*looked_up(where, self.cells), strict=True):
            found += embedding_bag(
                corner, self.table, self.starts, mode="sum", per_sample_weights=weight * self.shares
            )
        return np.asarray(found.numpy().reshape(6, self.size, self.size, 3))


def gathered(light: Source | Environment, grid: Grid, cells: int) -> FloatArray:
    """What of a light, and of light 1 from all around, falls to the vertices of a grid, (V, 4).

    The sphere is sampled as equirectangular pictures are: texel by texel of such a light, or in
    whole parts of texels, so that no energy is lost between samples.
    """
    source = light.source if isinstance(light, Environment) else light
    least = math.ceil(ROWS * cells)
    height = len(source.texels) if isinstance(source, Picture) else least
    rows = height * math.ceil(least / height)
    turn = light.rotation if isinstance(light, Environment) else np.eye(3)
    edges = math.pi * np.arange(rows + 1) / rows
    up, flat = np.cos(edges[:-1] + edges[1] / 2), np.sin(edges[:-1] + edges[1] / 2)
    area = -np.diff(np.cos(edges)) * (edges[1])  # of a texel of each row
    around = math.pi * (2.0 * np.arange(2 * rows) + 1.0) / (2 * rows)
    ring = -np.stack([np.cos(around), np.zeros(2 * rows), np.sin(around)], axis=1)
    found = np.zeros((len(grid.places), 4))
    step = max(1, BLOCK // (2 * rows))
    for start in range(0, rows, step):
        own = slice(start, start + step)
        where = flat[own, None, None] * ring + up[own, None, None] * np.array([0.0, 1.0, 0.0])
        where = where.reshape(-1, 3) @ turn.T
        share = np.repeat(area[own], 2 * rows)
        falls = np.column_stack([light.radiance(where) * share[:, None], share])
        corners, weights = looked_up(where.T.astype(np.float32), cells)
        vertex = grid.vertex[corners].ravel()
        for channel, one in enumerate(falls.T):
            found[:, channel] += np.bincount(vertex, (weights * one).ravel(), len(found))
    return found


@lru_cache(maxsize=2)
def heat(cells: int, spread: float) -> tuple[scipy.sparse.csr_array, int, FloatArray]:
    """A step of heat on a grid's vertices, how often it makes a Gaussian, and the areas (V,).

    Explicit steps of ∂x/∂t = Δx, each as long as is stable; the Gaussian has a variance of 2t.

    Args:
        cells: of the grid, a side.
        spread: standard deviation of the Gaussian along the sphere, radians.
    """
    grid = grid_of(cells)
    stiffness, areas = cotangent_laplacian(grid.places, grid.faces)
    fastest = float((2.0 * stiffness.diagonal() / areas).max())  # no eigenvalue is larger
    time = spread**2 / 2.0
    count = max(1, math.ceil(time * fastest))
    rate = scipy.sparse.diags_array(time / count / areas) @ stiffness
    step = scipy.sparse.csr_array(scipy.sparse.eye_array(len(areas)) - rate)
    return step.astype(np.float32), count, areas


def warmed(falls: FloatArray, cells: int, spread: float) -> FloatArray:
    """The table's radiance (V, 3) float32 of what falls to its vertices (V, 4)."""
    step, count, areas = heat(cells, spread)
    found = (falls / areas[:, None]).astype(np.float32)
    for _ in range(count):
        found = step @ found
    return np.asarray(found[:, :3] / found[:, 3:])  # light 1 stays 1
