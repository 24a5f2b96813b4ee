"""A perspective camera; matrices follow OpenGL: right-handed, looking along −z, clip z in [−w, w].

Matrices multiply columns: ``clip = projection @ view @ (x, y, z, 1)``.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from prtnet.arrays import FloatArray

__all__ = ["Camera"]

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Camera:
    """Where a picture is taken from.

    Attributes:
        eye: position, metres.
        target: a point in the middle of the picture.
        up: a direction that points up in the picture, not along the view.
        fov: full vertical field of view, radians.
        near, far: distances of the clip planes along the view, metres.
    """

    eye: Vector
    target: Vector
    up: Vector = (0.0, 1.0, 0.0)
    fov: float = math.radians(30.0)
    near: float = 0.1
    far: float = 100.0

    @classmethod
    def framing(
        cls,
        positions: FloatArray,
        aspect: float,
        azimuth: float = math.radians(30.0),
        elevation: float = math.radians(12.0),
        fov: float = math.radians(30.0),
        margin: float = 1.12,
    ) -> Camera:
        """The closest camera of a given direction that sees all points.

        In view axes (x right, y up, z towards the viewer) a camera at c sees point p where
        ``|p_x − c_x| ≤ t_x (c_z − p_z)`` with t_x the tangent of half the angle, and so for y.
        Each inequality is linear in c: the extreme point of each side of the frustum decides.

        Args:
            positions: points to see, (..., 3) metres; several poses may be given at once.
            aspect: width over height.
            azimuth: 0 looks at the character's face (+z), positive walks to its left (+x); radians.
            elevation: above the horizon, radians, less than a right angle.
            fov: full vertical field of view, radians.
            margin: size of the picture relative to the tightest one.
        """
        points = np.asarray(positions, dtype=np.float64).reshape(-1, 3)
        points = points[np.isfinite(points).all(axis=1)]
        if not len(points):
            points = np.zeros((1, 3))
        low, high = points.min(axis=0), points.max(axis=0)
        middle, span = low / 2.0 + high / 2.0, float((high - low).max())
        points = points - middle  # how far from the origin it is changes nothing
        towards = np.array([math.sin(azimuth), math.tan(elevation), math.cos(azimuth)])
        towards *= math.cos(elevation)
        axes = view_axes(towards, np.array([0.0, 1.0, 0.0]))
        x, y, z = axes @ points.T
        tangent_y = math.tan(fov / 2) / margin
        least = 1e-3 * span if span > 0.0 else 1e-6 * max(float(np.abs(middle).max()), 1.0)
        centre, distance = [0.0, 0.0], z.max() + 0.5 * max(float(np.ptp(z)), least)
        for axis, (p, tangent) in enumerate([(x, tangent_y * aspect), (y, tangent_y)]):
            right, left = (p + tangent * z).max(), (tangent * z - p).max()
            centre[axis] = (right - left) / 2
            distance = max(distance, (right + left) / (2 * tangent))
        eye = middle + axes.T @ np.array([*centre, distance])
        nearest, farthest = distance - z.max(), distance - z.min()
        return cls(
            eye=(float(eye[0]), float(eye[1]), float(eye[2])),
            target=tuple((eye - towards * (nearest + farthest) / 2).tolist()),
            fov=fov,
            near=float(0.5 * nearest),
            far=float(2.0 * farthest),
        )

    def around(self, turn: float) -> Camera:
        """The camera after it has walked around its target, towards +x from +z, by radians."""
        c, s = math.cos(turn), math.sin(turn)
        x, y, z = (e - t for e, t in zip(self.eye, self.target, strict=True))
        eye = (self.target[0] + c * x + s * z, self.target[1] + y, self.target[2] + c * z - s * x)
        return dataclasses.replace(self, eye=eye)

    def nearer(self, zoom: float) -> Camera:
        """The camera so many times closer to its target."""
        if zoom == 1.0:
            return self
        eye, target = np.asarray(self.eye), np.asarray(self.target)
        x, y, z = (target + (eye - target) / zoom).tolist()
        near = 0.02 * float(np.linalg.norm(eye - target)) / zoom
        return dataclasses.replace(self, eye=(x, y, z), near=near)

    def view(self) -> FloatArray:
        """World to camera, (4, 4)."""
        eye = np.asarray(self.eye, dtype=np.float64)
        axes = view_axes(eye - np.asarray(self.target), np.asarray(self.up, dtype=np.float64))
        matrix = np.eye(4)
        matrix[:3, :3] = axes
        matrix[:3, 3] = -axes @ eye
        return matrix

    def projection(self, aspect: float) -> FloatArray:
        """Camera to clip space, (4, 4); ``aspect`` is width over height."""
        scale = 1.0 / math.tan(self.fov / 2)
        depth = self.near - self.far
        matrix = np.zeros((4, 4))
        matrix[0, 0], matrix[1, 1] = scale / aspect, scale
        matrix[2, 2] = (self.near + self.far) / depth
        matrix[2, 3] = 2 * self.near * self.far / depth
        matrix[3, 2] = -1.0
        return matrix

    def matrix(self, aspect: float) -> FloatArray:
        """World to clip space, (4, 4)."""
        return self.projection(aspect) @ self.view()


def view_axes(towards: FloatArray, up: FloatArray) -> FloatArray:
    """Rows right, up and towards the viewer, (3, 3), orthonormal."""
    z = towards / np.linalg.norm(towards)
    x = np.cross(up, z)
    if np.linalg.norm(x) < 1e-9 * np.linalg.norm(up):  # looking straight up or down
        x = np.cross([0.0, 0.0, -1.0], z)
    x = x / np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])
