"""Pictures of materials: what prediction and order-limited shading get wrong, and why.

python bench/materials.py [--write]
"""

from __future__ import annotations

import itertools
import math
import sys
from collections.abc import Callable

import numpy as np
from tables import CHARACTERS, OUT, ROOT, SCENES, publish, scene_path

from data_gen.radiance import trace_radiance
from data_gen.readers import read_scene
from data_gen.truth import true_visibility
from prtnet import sh
from prtnet.arrays import FloatArray
from prtnet.brdf import BRDF
from prtnet.environment import Environment, environment
from prtnet.materials import PRESETS, brdf_named, material
from prtnet.model import VisibilityModel
from prtnet.modelled_scene import ModelledScene
from prtnet.reflection import local_view
from prtnet.zh import exact_lobes
from prtnet.zh_fit import fit_lobes
from runtime.camera import Camera
from runtime.draw import Renderer, opened, render_colours, render_material
from runtime.picture import Panel, auto_exposure, compose_panels, develop, save_png
from runtime.posed_surface import coloured_surface, posed_subject

LIGHTS = ("studio", "sunset", str(SCENES / "probes" / "dresden_square_1k.hdr"))
RAYS = 1024
SIZE = (320, 400)
BLOCK = 256
STEPS = ("light's bands", "visibility's bands", "factors, view's bands", "lobes", "model")


class Scene:
    """A character in the middle of a clip that its model has not seen."""

    def __init__(self, name: str, renderer: Renderer) -> None:
        file, scene, clip = CHARACTERS[name]
        self.model = VisibilityModel.load(OUT / file)
        self.actor = ModelledScene(self.model, read_scene(scene_path(scene)))
        found = self.actor.scene.clip(clip)
        self.pose = self.actor.poses(clip, np.array([(found.start + found.end) / 2]))
        self.positions = self.actor.scene.geometry(self.pose).positions[0]
        self.camera = Camera.framing(self.positions, SIZE[0] / SIZE[1])
        self.eye = np.asarray(self.camera.eye)
        self.renderer = renderer
        actor = self.actor
        self.given = (actor.scene, actor.receivers, actor.frame_field, self.pose)
        self.visibility = true_visibility(actor, self.pose, RAYS, 2)

    def coloured(self, radiance: FloatArray) -> FloatArray:
        """The picture of receivers' radiance."""
        surface = coloured_surface(self.actor, self.positions, radiance)
        return render_colours(self.renderer, surface, self.camera, SIZE)

    def traced(
        self, brdf: BRDF, light: Environment | Callable[[FloatArray], FloatArray]
    ) -> FloatArray:
        """By rays, without limits."""
        return self.coloured(trace_radiance(*self.given, self.eye, light, brdf, RAYS, 2))

    def band_limited(self, brdf: BRDF, light: FloatArray) -> FloatArray:
        """By quadrature of order-limited light and visibility with the BRDF itself."""
        order = self.model.order
        local = sh.fibonacci_hemisphere(RAYS)
        rows = sh.evaluate(local, order)
        frames = self.actor.frames(self.pose)[0].astype(np.float64)
        points = self.actor.geometry(self.pose).positions[0]
        view = local_view(points, self.eye, frames)
        result = np.empty((len(points), 3), dtype=np.float32)
        for start in range(0, len(points), BLOCK):
            part = slice(start, start + BLOCK)
            world = local @ frames[part].swapaxes(1, 2)
            arriving = sh.evaluate(world.reshape(-1, 3), order) @ light
            seen = (self.visibility[part] @ rows.T)[..., None]
            weight = local[:, 2:] * (2 * math.pi / RAYS)
            f = brdf(local[None], view[part, None]) * weight
            result[part] = (arriving.reshape(*world.shape) * seen * f).sum(axis=1)
        return self.coloured(result)

    def shaded(
        self, brdf: BRDF, light: FloatArray, lobes: int, visibility: FloatArray
    ) -> FloatArray:
        """By reflection product operators, as a frame is."""
        found = exact_lobes(light.T) if lobes == 0 else fit_lobes(light.T, lobes)
        operator = material(brdf, 8, self.model.order)
        subject = posed_subject(self.actor, self.pose, visibility)
        return render_material(self.renderer, subject, found, operator, self.camera, SIZE)


def rms(one: FloatArray, other: FloatArray, exposure: float) -> float:
    """Root mean square over drawn pixels and colours, of white 1, clipped as a screen does."""
    drawn = one[..., 3] == 1.0
    pair = [np.clip(exposure * picture[drawn][:, :3], 0.0, 1.0) for picture in (one, other)]
    return float(np.sqrt(np.mean(np.square(pair[0] - pair[1], dtype=np.float64))))


def pictures(scene: Scene, name: str, light: Environment) -> tuple[list[float], list[FloatArray]]:
    """Errors of prediction, of exact visibility, and of each step between; three pictures."""
    brdf = brdf_named(name)
    limited = light.harmonics(scene.model.order)
    truth = scene.traced(brdf, light)
    exposure = auto_exposure(truth)
    order = scene.model.order

    def soft(directions: FloatArray) -> FloatArray:
        return np.asarray(sh.evaluate(directions, order) @ limited)

    predicted = scene.model(scene.pose)[0]
    chain = [
        truth,
        scene.traced(brdf, soft),
        scene.band_limited(brdf, limited),
        scene.shaded(brdf, limited, 0, scene.visibility),
        scene.shaded(brdf, limited, 3, scene.visibility),
        scene.shaded(brdf, limited, 3, predicted),
    ]
    steps = [rms(one, other, exposure) for one, other in itertools.pairwise(chain)]
    errors = [rms(truth, chain[-1], exposure), rms(truth, chain[-2], exposure), *steps]
    return errors, [develop(picture, exposure) for picture in (chain[-1], truth)]


def main() -> None:
    """Every character under every light in every material."""
    rows, everything = [], {}
    with opened("gl") as renderer:
        for character in CHARACTERS:
            scene = Scene(character, renderer)
            sheet = []
            for light, name in itertools.product(LIGHTS, PRESETS):
                label = light.rpartition("/")[2].partition(".")[0]
                errors, pair = pictures(scene, name, environment(light))
                everything[character, label, name] = errors
                psnr = [f"{-20 * math.log10(max(error, 1e-9)):.1f}" for error in errors[:2]]
                cells = [f"{100 * error:.2f}" for error in errors]
                rows.append([f"{character}, {label}, {name}", cells[0], psnr[0], cells[1], psnr[1],
                             *cells[2:]])  # fmt: skip
                print(rows[-1], flush=True)
                sheet.append(Panel(np.concatenate(pair, axis=1), f"{label}, {name}",
                                   f"prediction and truth, rms {cells[0]} %"))  # fmt: skip
            if "--write" in sys.argv:
                lines = [compose_panels(sheet[k : k + 3]) for k in range(0, len(sheet), 3)]
                save_png(ROOT / "docs" / "figures" / f"materials_{character}.png",
                         np.concatenate(lines)[::2, ::2])  # fmt: skip
    columns = ("character, light, material", "prediction", "dB", "exact visibility", "dB", *STEPS)
    note = (
        "Root mean square over pixels and colours, per cent of white; dB: PSNR. The last five "
        "columns: what each step alone changes."
    )
    publish("materials", columns, rows, note=note)


if __name__ == "__main__":
    main()
