"""Small shaded scenes for the tests of pictures."""

from __future__ import annotations

import numpy as np
from trimesh.creation import icosphere, torus

from prtnet import sh
from runtime.camera import Camera
from runtime.reflected import Side, Subject
from runtime.shading import Surface, world_transfer

__all__ = ["frames_of", "knot", "knot_subject", "sky", "three_quarters"]


def frames_of(normals: np.ndarray) -> np.ndarray:
    """Any right-handed frames (V, 3, 3) with these normals."""
    helper = np.where(np.abs(normals[:, :1]) < 0.9, [[1.0, 0, 0]], [[0, 1.0, 0]])
    tangent = np.cross(normals, helper)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    return np.stack([tangent, np.cross(normals, tangent), normals], axis=-1)


def knot(order: int = 4, two_sided: bool = False, detail: int = 3) -> Surface:
    """As ``knot_subject``, diffuse."""
    subject = knot_subject(order, two_sided, detail)
    front, *back = (world_transfer(side.visibility, side.frames) for side in subject.sides)
    return Surface(subject.positions, subject.faces, front, back[0] if back else None)


def knot_subject(order: int = 4, two_sided: bool = False, detail: int = 3) -> Subject:
    """A ball through a ring, with smooth made-up visibility: silhouettes, holes, intersections."""
    ring, ball = torus(1.0, 0.35), icosphere(subdivisions=detail, radius=0.7)
    positions = np.concatenate([ring.vertices, ball.vertices]).astype(np.float32)
    normals = np.concatenate([ring.vertex_normals, ball.vertex_normals])
    faces = np.concatenate([ring.faces, ball.faces + len(ring.vertices)])
    rng = np.random.default_rng(7)
    visibility = 0.3 * np.sin(3 * positions @ rng.normal(size=(3, order * order)))
    visibility[:, 0] += np.sqrt(4 * np.pi) * 0.7
    front, back = (Side(visibility, frames_of(sign * normals)) for sign in (1.0, -1.0))
    return Subject(positions, faces.astype(np.int32), front, back if two_sided else None)


def sky(order: int = 4) -> np.ndarray:
    """A coloured light from above, (n², 3)."""

    def radiance(directions: np.ndarray) -> np.ndarray:
        key = np.exp(5 * (directions @ [-0.48, 0.6, 0.64] - 1))[:, None]
        return 0.2 + key * np.array([4.0, 3.4, 2.8])

    return sh.project_function(radiance, order)


def three_quarters(surface: Surface | Subject, size: tuple[int, int]) -> Camera:
    """A camera that sees the whole surface."""
    return Camera.framing(surface.positions, size[0] / size[1], azimuth=0.6, elevation=0.5)
