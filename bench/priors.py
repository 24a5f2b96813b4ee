"""What visibility of a pose costs in ONNX on the CPU, and in a vertex shader, beside its error.

python bench/priors.py [robot|human] [--write]
"""

from __future__ import annotations

import sys

import moderngl
import numpy as np
from shading import milliseconds
from tables import CHARACTERS, OUT, per_cent, publish, scene_path

from data_gen.readers import read_scene
from prtnet.cli_view import rebuilt
from prtnet.environment import environment
from prtnet.errors import PrtnetError
from prtnet.gpu_tables import GPUTables
from prtnet.materials import brdf_named, material
from prtnet.model import VisibilityModel
from prtnet.modelled_scene import ModelledScene
from prtnet.reflection import ReflectionOperator
from prtnet.zh import Lobes
from prtnet.zh_fit import fit_lobes
from runtime.camera import Camera
from runtime.gl import create_context
from runtime.onnx_model import OnnxModel
from runtime.posed_surface import posed_subject, sides
from runtime.reflected import Subject
from runtime.stage import Stage
from training.onnx_export import build_onnx

MODELS = {
    "robot": ("neural, occluders", "hybrid", "shared", "preset tiny"),
    "human": tuple(
        f"clips and 600 sampled poses, {name}"
        for name in ("neural, occluders, 14 latents", "preset tiny", "preset best")
    ),
}
STORAGES = ("float16", "int8")
COLUMNS = (
    "model", "held-out", "CPU", "latents", "occluders", "upload", "vertices shaded",
    "rebuilding", "MB", "of the prior",
)  # fmt: skip


class Drawn:
    """A subject on a stage, all of its vertices shaded for one pixel."""

    def __init__(self, context: moderngl.Context, subject: Subject, lobes: Lobes,
                 operator: ReflectionOperator) -> None:  # fmt: skip
        self.context, self.subject = context, subject
        self.lobes, self.operator = lobes, operator
        size = (64, 64)
        self.frame = context.framebuffer(
            [context.texture(size, 4, dtype="f4")], context.depth_renderbuffer(size)
        )
        self.frame.scissor = (0, 0, 1, 1)
        camera = Camera.framing(subject.positions, 1.0)
        self.matrix, self.eye = camera.matrix(1.0), np.asarray(camera.eye)

    def stage(self, order: int, tables: GPUTables | None) -> Stage:
        """A stage, lit."""
        stage = Stage(self.context, order, tables)
        stage.light(self.lobes)
        stage.material(self.operator)
        return stage

    def shading(self, stage: Stage) -> float:
        """Milliseconds of its vertices."""
        return milliseconds(lambda: stage.draw(self.frame, self.matrix, self.eye), self.context)


def rows_of(name: str, context: moderngl.Context) -> list[list[str]]:
    """A row for every model of a character and every storage."""
    _, file, clip = CHARACTERS[name]
    scene = read_scene(scene_path(file))
    rows = []
    for label in MODELS[name]:
        try:
            whole = VisibilityModel.load(OUT / f"{name} {label}.safetensors")
        except PrtnetError as error:
            print(f"{error}: run bench/models.py {name}", flush=True)
            continue
        for storage in STORAGES:
            actor = ModelledScene(whole.stored_as(storage), scene)
            rows.append([f"{name}, {label}, {storage}", *measured(actor, clip, context)])
            print(rows[-1], flush=True)
    return rows


def measured(actor: ModelledScene, clip: str, context: moderngl.Context) -> list[str]:
    """What a model costs in the middle of a clip."""
    model = actor.model
    found = actor.scene.clip(clip)
    pose = actor.poses(clip, np.array([(found.start + found.end) / 2]))
    cpu = OnnxModel(build_onnx(model).SerializeToString(), 2)
    given, occluders = rebuilt(model, 2)
    assert given is not None
    latents, tables = given
    subject = posed_subject(actor, pose, model(pose)[0])
    lobes = fit_lobes(environment("studio").harmonics(model.order).T, 3)
    drawn = Drawn(context, subject, lobes, material(brdf_named("gold"), 8, model.order))
    plain = drawn.stage(model.order, None)
    plain.show(subject)
    without = drawn.shading(plain)
    plain.release()
    stage = drawn.stage(model.order, tables)
    front, back = sides(actor)
    receivers = [front] if back is None else [front, back]
    texels = None if occluders is None else occluders(pose)[0]
    values = latents(pose)[0]
    around = {} if tables.prior is None else tables.prior.textures
    spent = [
        cpu.milliseconds(pose),
        milliseconds(lambda: latents(pose), context),
        0.0 if occluders is None else milliseconds(lambda: occluders(pose), context),
        milliseconds(lambda: stage.show_latents(subject, values, receivers, texels), context),
        drawn.shading(stage),
    ]
    stage.release()
    drawn.frame.release()
    return [
        per_cent(model.metadata["held_out_error"]["rms"]),
        *(f"{ms:.2f}" for ms in (*spent, spent[-1] - without)),
        f"{sum(texture.nbytes for texture in tables.textures.values()) / 1e6:.2f}",
        f"{sum(texture.nbytes for texture in around.values()) / 1e6:.2f}",
    ]


def main() -> None:
    """Models with and without priors, in half precision and in 8 bits."""
    chosen = [name for name in MODELS if name in sys.argv] or list(MODELS)
    context = create_context()
    with context:
        device = str(context.info["GL_RENDERER"])
        rows = [row for name in chosen for row in rows_of(name, context)]
    context.release()
    publish("priors in a shader", COLUMNS, rows, note=f"Milliseconds; OpenGL by {device}.")


if __name__ == "__main__":
    main()
