"""The exported GLSL run for every receiver, without a picture: transform feedback on llvmpipe."""

from __future__ import annotations

from typing import Any

import moderngl
import numpy as np

from prtnet.glsl import texture
from prtnet.gpu_tables import GPUTables, glsl, gpu_tables
from prtnet.model import VisibilityModel
from runtime.gl import create_context

SHADER = """%s
%s
%s
void main() {
    vec4 v[PRTNET_TEXELS];
    prtnet_visibility(gl_VertexID, v);
%s
}
"""
DESKTOP = "#version 330"
WEB = "#version 300 es\nprecision highp float;\nprecision highp int;"  # of WebGL 2
UPLOADS = {
    "int8": ("ni1", 0x8F97),  # signed normalised; moderngl would make it unsigned
    "uint16": ("u2", None),
    "uint32": ("u4", None),
    "float16": ("f2", None),
    "float32": ("f4", None),
}


def transformed(
    text: str, textures: dict[str, Any], posed: list[dict[str, Any]], receivers: int, texels: int,
    head: str = DESKTOP,
) -> np.ndarray:  # fmt: skip
    """What ``prtnet_visibility`` of an include gives every receiver, (P, V, 4 · texels).

    Args:
        text: the include.
        textures: by name, those that stay.
        posed: those of each pose.
        receivers: V.
        texels: of the coefficients.
        head: version and precision.
    """
    names = [f"v{k}" for k in range(texels)]
    outs = "\n".join(f"out vec4 {name};" for name in names)
    writes = "\n".join(f"    {name} = v[{k}];" for k, name in enumerate(names))
    context = create_context()
    with context:
        # OpenGL wants a framebuffer even where nothing is drawn.
        context.simple_framebuffer((1, 1)).use()
        program = context.program(vertex_shader=SHADER % (head, text, outs, writes), varyings=names)
        points = context.vertex_array(program, [])
        got = []
        for pose in posed:
            for unit, (name, array) in enumerate({**textures, **pose}.items()):
                dtype, internal = UPLOADS[array.dtype.name]
                image = context.texture(
                    array.shape[1::-1], array.shape[2], array.tobytes(), dtype=dtype,
                    internal_format=internal,
                )  # fmt: skip
                image.filter = (moderngl.NEAREST, moderngl.NEAREST)
                image.use(unit)
                program[name] = unit
            buffer = context.buffer(reserve=receivers * 16 * texels)
            points.transform(buffer, moderngl.POINTS, vertices=receivers)
            got.append(np.frombuffer(buffer.read(), np.float32).reshape(receivers, -1))
    context.release()
    return np.stack(got)


def shaded(model: VisibilityModel, poses: np.ndarray, head: str = DESKTOP) -> np.ndarray:
    """A model's visibility (P, V, n²) of poses (P, D) by its shader, latents by NumPy."""
    tables = gpu_tables(model)
    posed = []
    for pose in poses:
        given = {"prtnet_latents": texture(latents_of(model, tables, pose)[:, None])}
        if tables.prior is not None:
            given["prtnet_prior_pose"] = texture(tables.prior.seen.posed(pose))
        posed.append(given)
    count, receivers = model.order**2, model.receiver_count
    got = transformed(glsl(tables), tables.textures, posed, receivers, -(-count // 4), head)
    assert (got[..., count:] == 0).all()
    return got[..., :count]


def latents_of(model: VisibilityModel, tables: GPUTables, pose: np.ndarray) -> np.ndarray:
    """Latents (Σ,) of a pose (D,) as a shader wants them."""
    found = model.latent(pose[None])[0]
    used = np.arange(found.shape[1]) < model.latents[:, None]
    return (found[used] * tables.latent_scale).astype(np.float32)
