"""Light that surfaces send to an eye, by ray tracing: no band limit, no factors, no lobes.

L = ∫ light(s) V(s) f(s, eye) max(n·s, 0) ds at every receiver, by the rays that trace visibility:
what reflection product operators are judged by. Direct light alone, as theirs is. Rays are spread
evenly: a light, or a highlight, must be wide enough for some of them to find it (the sun is not).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from data_gen.rays import border_operator, departure
from data_gen.visibility import Hemisphere, Tracer
from prtnet.arrays import FloatArray
from prtnet.brdf import BRDF
from prtnet.frames import FrameField
from prtnet.reflection import local_view
from prtnet.scene import Receivers, Scene

__all__ = ["trace_radiance"]

BATCH = 1 << 16  # rays at a time: each needs some tens of numbers


def trace_radiance(
    scene: Scene,
    receivers: Receivers,
    frame_field: FrameField,
    pose: FloatArray,
    eye: FloatArray,
    light: Callable[[FloatArray], FloatArray],
    brdf: BRDF,
    rays: int = 1024,
    threads: int = 1,
) -> FloatArray:
    """Radiance (V, 3) float32, linear RGB, that receivers send to an eye.

    Args:
        scene: the animated mesh.
        receivers: of that scene.
        frame_field: their tangent frames.
        pose: flattened, (1, D).
        eye: where the camera is, (3,) world space.
        light: radiance (N, 3) of unit directions (N, 3), world space.
        brdf: of the surface, in its local frames.
        rays: above the horizon of every receiver.
        threads: that trace.
    """
    mesh = scene.geometry(pose)
    surface = receivers.gather(mesh)
    points, normals = surface.positions[0], surface.normals[0]
    frames = frame_field.frames(pose, surface)[0].astype(np.float32)
    tracer = Tracer(mesh.positions[0], scene.faces)
    inward = border_operator(scene.faces, receivers)
    origins = tracer.origins(points, departure(normals, inward @ mesh.positions[0]))
    view = local_view(points, eye, frames)
    local = Hemisphere(1, rays).directions
    weight = (local[:, 2] * (2.0 * math.pi / rays))[:, None]

    def reflected(part: slice) -> FloatArray:
        world = local @ frames[part].transpose(0, 2, 1)  # [B, K, 3]
        start = np.repeat(origins[part, None], rays, axis=1)
        hit = tracer.occluded(start.reshape(-1, 3), world.reshape(-1, 3))
        arriving = np.zeros((len(hit), 3))
        arriving[~hit] = light(world.reshape(-1, 3)[~hit].astype(np.float64))
        seen = brdf(local[None], view[part, None]) * weight
        return np.asarray((arriving.reshape(*world.shape) * seen).sum(axis=1))

    size = max(1, BATCH // rays)
    parts = [slice(start, start + size) for start in range(0, len(points), size)]
    with ThreadPoolExecutor(threads) as pool:
        return np.concatenate(list(pool.map(reflected, parts))).astype(np.float32)
