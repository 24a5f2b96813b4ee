"""Light that surfaces send to an eye, by ray tracing: no band limit, no factors, no lobes.

L = ∫ light(s) V(s) f(s, eye) max(n·s, 0) ds at every receiver, by the rays that trace visibility:
what reflection product operators are judged by. Direct light alone, as theirs is. Rays go to where
the light is, and to where the surface reflects from (``data_gen.directions``): small lights and
narrow highlights are found. Every receiver has random numbers of its own.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from data_gen.cube_visibility import inwards, joined
from data_gen.directions import Aimed, Light, Places, Plan, Sampling, plan
from data_gen.rays import border_operator, departure
from data_gen.visibility import Tracer
from prtnet.arrays import FloatArray
from prtnet.brdf import BRDF
from prtnet.cores import lasting_threads
from prtnet.environment import Environment
from prtnet.frames import FrameField, orthonormal_frames
from prtnet.reflection import local_view
from prtnet.scene import Receivers, Scene
from prtnet.transfer import Surface

__all__ = ["trace_radiance", "trace_surface"]

BATCH = 1 << 15  # rays at a time: each needs some tens of numbers


def trace_radiance(
    scene: Scene,
    receivers: Receivers,
    frame_field: FrameField,
    pose: FloatArray,
    eye: FloatArray,
    light: Light,
    brdf: BRDF,
    rays: int = 1024,
    threads: int = 1,
    sampling: Sampling = "mixed",
    seed: int = 0,
) -> FloatArray:
    """Radiance (V, 3) float32, linear RGB, that receivers send to an eye: right on average.

    Args:
        scene: the animated mesh.
        receivers: of that scene.
        frame_field: their tangent frames.
        pose: flattened, (1, D).
        eye: where the camera is, (3,) world space.
        light: distant; or radiance (N, 3) of unit directions (N, 3), world space, smooth enough to
            be found by rays that are spread evenly.
        brdf: of the surface, in its local frames.
        rays: of every receiver.
        threads: that trace.
        sampling: where rays go: to light and reflection in equal parts, ``mixed``, or else what
            that is compared with.
        seed: of the random numbers.
    """
    mesh = scene.geometry(pose)
    surface = receivers.gather(mesh)
    points, normals = surface.positions[0], surface.normals[0]
    frames = frame_field.frames(pose, surface)[0].astype(np.float64)
    tracer = Tracer(mesh.positions[0], scene.faces)
    inward = border_operator(scene.faces, receivers)
    origins = tracer.origins(points, departure(normals, inward @ mesh.positions[0]))
    places = Places(frames, local_view(points, eye, frames))
    return traced(tracer, origins, places, light, brdf, rays, threads, sampling, seed)


def trace_surface(
    surface: Surface,
    casters: Sequence[Surface],
    eye: FloatArray,
    light: Light,
    brdf: BRDF,
    rays: int = 1024,
    threads: int = 1,
    sampling: Sampling = "mixed",
    seed: int = 0,
) -> FloatArray:
    """As :func:`trace_radiance`, of the vertices of a still surface among others, (P, 3) float32.

    Args:
        surface: the vertices, in the frames that it gives them.
        casters: what hides light: the surface itself as a rule, and what else is there.
        eye: where the camera is, (3,) world space.
        light: as there.
        brdf: of the surface, in its frames.
        rays: of every vertex.
        threads: that trace.
        sampling: where rays go.
        seed: of the random numbers.

    Raises:
        ValueError: no caster has a triangle.
    """
    tracer = Tracer(*joined(casters))
    frames = orthonormal_frames(surface.tangents, surface.normals)
    away = frames[..., 2]
    if any(one is surface for one in casters):
        away = departure(away, inwards(surface))
    origins = tracer.origins(surface.positions, away)
    places = Places(frames, local_view(surface.positions, eye, frames))
    return traced(tracer, origins, places, light, brdf, rays, threads, sampling, seed)


def traced(
    tracer: Tracer,
    origins: FloatArray,
    places: Places,
    light: Light,
    brdf: BRDF,
    rays: int,
    threads: int,
    sampling: Sampling,
    seed: int,
) -> FloatArray:
    """Radiance (N, 3) float32 of places whose rays start at origins (N, 3) of the tracer."""
    ways = plan(light, brdf, rays, sampling)
    shifts = np.random.default_rng(seed).random((len(origins), len(ways.ways), 2))

    def reflected(part: slice) -> FloatArray:
        given = ways, places.at(part), shifts[part], origins[part]
        return estimate(*given, tracer, light, brdf)

    size = max(1, BATCH // ways.rays)
    parts = [slice(start, start + size) for start in range(0, len(origins), size)]
    found = lasting_threads(threads).map(reflected, parts)
    return np.concatenate(list(found)).astype(np.float32)


def estimate(
    ways: Plan,
    places: Places,
    shifts: FloatArray,
    origins: FloatArray,
    tracer: Tracer,
    light: Light,
    brdf: BRDF,
) -> FloatArray:
    """Radiance (N, 3) of a block of receivers, (N, …) as ``trace_radiance`` has them."""
    count = len(origins)
    world = ways.draw(places, shifts).reshape(-1, 3)
    owner = np.repeat(np.arange(count), ways.rays)
    local = (world.reshape(count, -1, 3) @ places.frames).reshape(-1, 3)
    above = np.flatnonzero(local[:, 2] > 0.0)
    hit = tracer.occluded(origins[owner[above]], world[above].astype(np.float32))
    open_ = above[~hit]
    world, local, owner = world[open_], local[open_], owner[open_]
    own = places.at(owner)
    density = ways.density(Aimed(own, world, local))
    radiance = light.radiance if isinstance(light, Environment) else light
    seen = brdf(local, own.view) * radiance(world)
    seen *= (local[:, 2] / np.maximum(density, 1e-300))[:, None]
    return np.stack([np.bincount(owner, colour, count) for colour in seen.T], axis=1)
