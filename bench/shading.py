"""What a frame costs, stage by stage, and what factors, lobes, order, vertices, characters add.

python bench/shading.py [--write]
"""

from __future__ import annotations

from typing import Any

import moderngl
import numpy as np
from tables import CHARACTERS, OUT, gpu_milliseconds, publish, scene_path

from data_gen.readers import read_scene
from prtnet.arrays import FloatArray
from prtnet.environment import environment
from prtnet.gpu_tables import gpu_tables
from prtnet.materials import brdf_named, material
from prtnet.model import VisibilityModel
from prtnet.modelled_scene import ModelledScene
from prtnet.reflection import ReflectionOperator
from prtnet.sh import fibonacci_sphere
from prtnet.zh import Lobes, exact_lobes
from prtnet.zh_fit import fit_lobes
from runtime.camera import Camera
from runtime.gl import create_context
from runtime.onnx_model import OnnxPart
from runtime.posed_surface import posed_subject, sides
from runtime.reflected import Side, Subject
from runtime.screen import Screen
from runtime.stage import Stage
from training.onnx_export import build_latent_onnx

SIZES = ((800, 600), (1920, 1080))


def character(name: str, context: moderngl.Context) -> list[list[str]]:
    """Stages of a frame of a model on its scene, for every size of the picture."""
    file, scene, clip = CHARACTERS[name]
    model = VisibilityModel.load(OUT / file)
    actor = ModelledScene(model, read_scene(scene_path(scene)))
    found = actor.scene.clip(clip)
    pose = actor.poses(clip, np.array([(found.start + found.end) / 2]))
    tables = gpu_tables(model)
    onnx = OnnxPart(build_latent_onnx(model, tables.latent_scale).SerializeToString(), 2)
    latents = onnx(pose)[0]
    front, back = sides(actor)
    receivers = [front] if back is None else [front, back]
    subject = posed_subject(actor, pose)
    lobes = fit_lobes(environment("studio").harmonics(model.order).T, 3)
    stage = Stage(context, model.order, tables)
    stage.light(lobes)
    stage.material(material(brdf_named("gold"), 8, model.order))
    common = [
        gpu_milliseconds(lambda: onnx(pose), context),
        gpu_milliseconds(lambda: posed_subject(actor, pose), context),
        gpu_milliseconds(lambda: stage.show_latents(subject, latents, receivers), context),
    ]
    rows = []
    for size in SIZES:
        screen, target = Screen(context), context.framebuffer([context.texture(size, 4)])
        camera = Camera.framing(subject.positions, size[0] / size[1])
        matrix, eye = camera.matrix(size[0] / size[1]), np.asarray(camera.eye)
        frame = screen.clear(size)
        frame.scissor = (0, 0, 1, 1)  # every vertex, one pixel
        shade = gpu_milliseconds(lambda: stage.draw(frame, matrix, eye), context)  # noqa: B023
        frame.scissor = None
        draw = gpu_milliseconds(lambda: stage.draw(frame, matrix, eye), context)  # noqa: B023
        shown = gpu_milliseconds(lambda: screen.present(target, 1.0), context)  # noqa: B023
        stages = [*common, shade, max(0.0, draw - shade), shown]
        label = f"{name}, {size[0]} × {size[1]}"
        vertices = str(len(subject.positions))
        rows.append([label, vertices, *(f"{ms:.2f}" for ms in (*stages, sum(stages)))])
        print(rows[-1], flush=True)
        screen.release()
        target.release()
    stage.release()
    return rows


def ball(vertices: int, order: int) -> Subject:
    """Vertices all over a sphere, of made-up visibility; a fan of faces so that all are shaded."""
    points = fibonacci_sphere(vertices).astype(np.float32)
    tangent = np.cross(points, [0.3, 0.9, 0.1])
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    frames = np.stack([tangent, np.cross(points, tangent), points], axis=-1)
    visibility = np.random.default_rng(0).normal(size=(vertices, order**2)).astype(np.float32)
    faces = np.arange(vertices - vertices % 3, dtype=np.int32).reshape(-1, 3)
    return Subject(points, faces, Side(visibility, frames))


def operator(order: int, factors: int) -> ReflectionOperator:
    """Of random numbers: what they are costs nothing."""
    rng = np.random.default_rng(0)
    shape = (factors, order**2, order**2)
    view = rng.normal(size=(factors, order**2, 3))
    return ReflectionOperator(rng.normal(size=shape).astype("f4"), view.astype("f4"))


def growth(context: moderngl.Context) -> list[list[str]]:
    """Vertex shading alone as each of its numbers grows from the same middle."""
    base: dict[str, Any] = {
        "vertices": 12000,
        "factors": 8,
        "lobes": 3,
        "order": 4,
        "characters": 1,
    }
    tried = {
        "vertices": (3000, 12000, 48000),
        "factors": (1, 4, 8, 16),
        "lobes": (1, 3, 7),
        "order": (2, 3, 4, 5, 6),
        "characters": (1, 10, 100),
    }
    frame = context.framebuffer(
        [context.texture((64, 64), 4, dtype="f4")], context.depth_renderbuffer((64, 64))
    )
    frame.scissor = (0, 0, 1, 1)
    rows = []
    for what, values in tried.items():
        found = []
        for value in values:
            now = base | {what: value}
            stage = Stage(context, now["order"])
            stage.show(ball(now["vertices"], now["order"]))
            stage.light(light(now["order"], now["lobes"]))
            stage.material(operator(now["order"], now["factors"]))

            def all_of_them(stage: Stage = stage, count: int = now["characters"]) -> None:
                for _ in range(count):
                    stage.draw(frame, np.eye(4), np.array([0.0, 0.0, 5.0]))

            found.append(gpu_milliseconds(all_of_them, context))
            stage.release()
        cells = ", ".join(f"{v}: {ms:.2f}" for v, ms in zip(values, found, strict=True))
        rows.append([what, cells])
        print(rows[-1], flush=True)
    return rows


def light(order: int, lobes: int) -> Lobes:
    """So many lobes of a colour."""
    target: FloatArray = environment("studio").harmonics(order).T
    found = exact_lobes(target)
    repeated = np.arange(lobes) % found.axes.shape[1]
    return Lobes(found.axes[:, repeated], found.coefficients[:, repeated])


def main() -> None:
    """Frames by stage, and how vertex shading grows."""
    context = create_context()
    with context:
        device = str(context.info["GL_RENDERER"])
        rows = [row for name in CHARACTERS for row in character(name, context)]
        columns = (
            "frame", "vertices", "latents", "pose", "upload", "vertices shaded", "pixels",
            "tone map", "all",
        )  # fmt: skip
        publish("shading", columns, rows, note=f"Milliseconds; OpenGL by {device}.")
        note = f"Milliseconds of shading all vertices; OpenGL by {device}."
        publish("shading growth", ("as it grows", "ms"), growth(context), note=note)
    context.release()


if __name__ == "__main__":
    main()
