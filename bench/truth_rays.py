"""Noise of the traced truth against rays, by where the rays go.

python bench/truth_rays.py [--write]

A bent arm made by code, so that nothing else is needed. Noise is the root mean square, over
receivers that face the eye and over seeds, of what one run is off the mean of others with many
rays, relative to the root mean square radiance.
"""

from __future__ import annotations

import itertools
import time
from typing import get_args

import numpy as np
from tables import publish

from data_gen.directions import Sampling
from data_gen.procedural import arm
from data_gen.radiance import trace_radiance
from prtnet.brdf import BRDF, GGX
from prtnet.environment import Environment, environment
from prtnet.equirectangular import Picture
from prtnet.frames import FrameField, rest_tangents
from prtnet.materials import PRESETS
from prtnet.reflection import local_view

WAYS: tuple[Sampling, ...] = get_args(Sampling)
RAYS = (64, 256, 1024)
REFERENCE = 4096
EYE = np.array([0.4, 0.8, 1.4])


def texel() -> Environment:
    """A grey panorama with one bright texel."""
    texels = np.full((256, 512, 3), 0.3)
    texels[64, 320] = 70_000.0
    return Environment(Picture(texels))


LIGHTS = {
    "studio": environment("studio"), "area": environment("area"), "sun": environment("sun"),
    "one texel of 70,000": texel(),
}  # fmt: skip
MATERIALS: dict[str, BRDF] = {
    "matte": PRESETS["matte"], "gold": PRESETS["gold"], "brushed": PRESETS["brushed"],
    "ggx:roughness=0.05": GGX(roughness=0.05),
}  # fmt: skip


def main() -> None:
    """Every light on every material, every way, as rays grow."""
    scene = arm(segments=10)
    receivers = scene.receivers()
    field = FrameField(scene, receivers, rest_tangents(scene, receivers))
    clip = scene.clips[0]
    pose = scene.poses(clip, np.array([(clip.start + clip.end) / 2]))
    points = receivers.gather(scene.geometry(pose)).positions[0]
    faces = local_view(points, EYE, field.frames(pose)[0])[:, 2] > 0.05
    rows = []
    spent = dict.fromkeys(WAYS, 0.0)
    for (light, one), (name, brdf) in itertools.product(LIGHTS.items(), MATERIALS.items()):
        given = (scene, receivers, field, pose, EYE, one, brdf)
        many = [trace_radiance(*given, REFERENCE, seed=seed) for seed in (100, 101)]
        truth = np.mean(many, axis=0)[faces]
        scale = np.sqrt(np.mean(truth**2))
        cells = []
        for way in WAYS:
            noise = []
            for rays in RAYS:
                runs = []
                for seed in range(2):
                    begun = time.perf_counter()
                    runs.append(trace_radiance(*given, rays, sampling=way, seed=seed)[faces])
                    spent[way] += time.perf_counter() - begun
                noise.append(np.sqrt(np.mean((np.stack(runs) - truth) ** 2)) / scale)
            cells.append(", ".join(f"{100 * value:.1f}" for value in noise))
        rows.append([f"{light}, {name}", *cells])
        print(rows[-1], flush=True)
    traced = len(LIGHTS) * len(MATERIALS) * len(points) * sum(RAYS) * 2
    cost = ", ".join(f"{way} {1e6 * spent[way] / traced:.2f}" for way in WAYS)
    note = (
        f"Per cent, with {', '.join(f'{rays:,}' for rays in RAYS)} rays a receiver. Microseconds "
        f"a ray, one thread: {cost}."
    )
    publish("truth rays", ("light, material", *WAYS), rows, note=note)


if __name__ == "__main__":
    main()
