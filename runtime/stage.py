"""Subjects, lights and materials on an OpenGL context: swapped one by one, drawn when wanted.

What changes each frame (vertices, frames, visibility) is written into buffers and textures that
stay; a light is some uniforms, a material two small textures. No shader is ever built again.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import moderngl
import numpy as np

from prtnet.arrays import FloatArray, IntArray
from prtnet.errors import PrtnetError
from prtnet.glsl import WIDTH, texture
from prtnet.gpu_tables import GPUTables
from prtnet.reflection import ReflectionOperator
from prtnet.zh import Lobes
from runtime.gpu_timer import GPUTimer
from runtime.material_shader import FRAGMENT_SHADER, most_lobes, vertex_shader
from runtime.reflected import Side, Subject
from runtime.vertex_probe import VertexProbe

__all__ = ["Stage"]

TEXTURE_WIDTH = WIDTH
SIDES = ("front", "back")
MODEL = (
    "prtnet_rows", "prtnet_receivers", "prtnet_latents", "prtnet_prior_numbers",
    "prtnet_prior_weights", "prtnet_prior_indices", "prtnet_prior_rest", "prtnet_prior_pose",
)  # fmt: skip
"""What rebuilds visibility."""
TEXTURES = ("matrices", "view_factors", "front_visibility", "back_visibility", *MODEL)
UPLOADS = {  # dtype and internal format; signed normalised bytes moderngl would make unsigned
    "int8": ("ni1", 0x8F97),
    "float16": ("f2", None),
    "float32": ("f4", None),
    "uint16": ("u2", None),
    "uint32": ("u4", None),
}
STAY = ("matrices", "view_factors", *MODEL)
"""Whatever the mesh is."""


class Stage:
    """One subject under one light, of one material.

    Args:
        context: that everything lives in; it must be current.
        order: bands n of visibility.
        tables: of a model, whose latents subjects are then shown with.

    Attributes:
        milliseconds: of the last ``show`` (on the CPU) and the ``draw`` before the last (on the
            GPU, where it has timers), by name.
    """

    def __init__(
        self, context: moderngl.Context, order: int, tables: GPUTables | None = None
    ) -> None:
        self.context, self.order = context, order
        self.texels = -(-(order**2) // 4)
        self.columns = TEXTURE_WIDTH // self.texels
        self.program: Any = context.program(
            vertex_shader=vertex_shader(order, self.columns, tables),
            fragment_shader=FRAGMENT_SHADER,
        )
        self.milliseconds: dict[str, float] = {}
        self._held: dict[str, Any] = {}
        self._mesh: Any = None
        self._shape: tuple[int, int, bool] | None = None
        self._faces: IntArray | None = None
        self._material: ReflectionOperator | None = None
        self._tables = tables
        self._probe: VertexProbe | None = None
        self._latents: Any = None
        self._occluders: Any = None
        self._timer = GPUTimer(context)
        for unit, name in enumerate(TEXTURES):
            self._set(name, unit)
        self.show_bands(0)
        if tables is not None:
            try:
                self._take(tables)
            except BaseException:
                self.release()
                raise

    def release(self) -> None:
        """Give everything back but the context."""
        for held in [self._mesh, self._probe, *self._held.values(), self.program]:
            if held is not None:
                held.release()
        self._held.clear()
        self._mesh = self._probe = None

    @property
    def resources(self) -> list[Any]:
        """Buffers and textures that are held."""
        return list(self._held.values())

    def show(self, subject: Subject) -> None:
        """Take a subject's pose.

        Raises:
            PrtnetError: it has more vertices than a texture of this OpenGL holds.
        """
        started = time.perf_counter()
        count = len(subject.positions)
        rows = -(-count // self.columns)
        if rows > int(self.context.info["GL_MAX_TEXTURE_SIZE"]):
            raise PrtnetError(
                "--renderer gl", f"{count} vertices do not fit a texture; use --renderer cpu"
            )
        shape = (count, len(subject.faces), subject.back is not None)
        if shape != self._shape:
            self._allocate(subject, shape, rows)
        if subject.faces is not self._faces:
            self._held["faces"].write(np.ascontiguousarray(subject.faces, dtype="i4"))
            self._faces = subject.faces
        self._held["positions"].write(np.ascontiguousarray(subject.positions, dtype="f4"))
        for name, side in zip(SIDES, subject.sides, strict=False):
            pair = side.frames[..., [0, 2]].swapaxes(1, 2)  # tangent, then normal
            self._held[f"{name}_frames"].write(np.ascontiguousarray(pair, dtype="f4"))
            if self._latents is None:
                self._held[f"{name}_visibility"].write(self._padded(side, rows))
        self.milliseconds["upload"] = 1e3 * (time.perf_counter() - started)

    def _take(self, tables: GPUTables) -> None:
        """Put a model's tables on the GPU."""
        latents = texture(np.zeros((len(tables.latent_scale), 1), dtype="f4"))
        arrays = tables.textures | {"prtnet_latents": latents}
        if tables.prior is not None:
            texels = np.zeros((tables.prior.seen.posed_texels, 4), dtype="f4")
            self._occluders = arrays["prtnet_prior_pose"] = texture(texels)
        limit = int(self.context.info["GL_MAX_TEXTURE_SIZE"])
        for name, array in arrays.items():
            if len(array) > limit:
                raise PrtnetError("model", "is too large for a texture here; train a smaller one")
            self._held[name] = self._texture(array)
        self._latents = latents

    def show_latents(
        self,
        subject: Subject,
        latents: FloatArray,
        receivers: Sequence[IntArray],
        occluders: FloatArray | None = None,
    ) -> None:
        """Take a pose of the model whose tables this has; visibility is rebuilt on the GPU.

        Args:
            subject: vertices and frames; visibility is not looked at.
            latents: from the graph of latents alone, (Σ latents,).
            receivers: of every vertex's front, and of its back if there is one, (V,) each.
            occluders: of a model with a prior: what changes with the pose, (N, 4); see
                ``prtnet.gpu_prior.PriorTables``.
        """
        assert self._latents is not None
        self.show(subject)
        started = time.perf_counter()
        for name, own in zip(SIDES, receivers, strict=False):
            self._held[f"{name}_receivers"].write(np.ascontiguousarray(own, dtype="i4"))
        self._pose(latents, occluders)
        self.milliseconds["upload"] += 1e3 * (time.perf_counter() - started)

    def _pose(self, latents: FloatArray, occluders: FloatArray | None) -> None:
        """Put what changes with the pose on the GPU."""
        self._latents.ravel()[: len(latents)] = latents
        self._held["prtnet_latents"].write(self._latents)
        if self._occluders is not None:
            assert occluders is not None
            self._occluders.reshape(-1, 4)[: len(occluders)] = occluders
            self._held["prtnet_prior_pose"].write(self._occluders)

    def visibility_of(
        self, receiver: int, latents: FloatArray, occluders: FloatArray | None = None
    ) -> FloatArray:
        """What one receiver sees (n²,), as the GPU rebuilds it; see ``show_latents``."""
        assert self._tables is not None
        if self._probe is None:
            units = {name: TEXTURES.index(name) for name in MODEL}
            self._probe = VertexProbe(self.context, self._tables, units)
        self._pose(latents, occluders)
        self._bind()
        return self._probe(receiver)

    def _allocate(self, subject: Subject, shape: tuple[int, int, bool], rows: int) -> None:
        """Buffers and textures of a new mesh."""
        count, _, both = shape
        held = self._held
        for name in [name for name in held if name not in STAY]:
            held.pop(name).release()
        if self._mesh is not None:
            self._mesh.release()
        held["faces"] = self.context.buffer(reserve=max(1, 12 * len(subject.faces)))
        self._faces = None
        held["positions"] = self.context.buffer(reserve=max(1, 12 * count))
        for name in SIDES if both else SIDES[:1]:
            held[f"{name}_frames"] = self.context.buffer(reserve=max(1, 24 * count))
            if self._latents is None:
                held[f"{name}_visibility"] = self._texture(self._padded(subject.front, rows))
            else:
                held[f"{name}_receivers"] = self.context.buffer(reserve=max(1, 4 * count))
        seen = "front", "back" if both else "front"
        self._mesh = self.context.vertex_array(
            self.program,
            [
                *self._attributes(held["positions"], "position"),
                *self._attributes(held["front_frames"], "front_tangent", "front_normal"),
                *self._attributes(held[f"{seen[1]}_frames"], "back_tangent", "back_normal"),
                *(
                    (held[f"{own}_receivers"], "1i", f"{name}_receiver")
                    for name, own in zip(SIDES, seen, strict=True)
                    if f"{name}_receiver" in self.program
                ),
            ],
            held["faces"],
        )
        self._set("two_sided", both)
        self._shape = shape

    def _attributes(self, buffer: Any, *names: str) -> list[tuple[Any, ...]]:
        """Three floats each; those that the shader of a low order has no use for are skipped."""
        used = [name for name in names if name in self.program]
        layout = " ".join("3f" if name in used else "12x" for name in names)
        return [(buffer, layout, *used)] if used else []

    def _set(self, name: str, value: Any) -> None:
        """A uniform, unless the shader of a low order has no use for it."""
        if name in self.program:
            if isinstance(value, np.ndarray):
                self.program[name].write(np.ascontiguousarray(value, dtype="f4"))
            else:
                self.program[name] = value

    def _padded(self, side: Side, rows: int) -> Any:
        """Visibility (V, n²) as whole texels and rows."""
        data = np.zeros((max(1, rows) * self.columns, 4 * self.texels), dtype="f4")
        data[: len(side.visibility), : self.order**2] = side.visibility
        return data.reshape(-1, self.columns * self.texels, 4)

    def _texture(self, array: Any) -> Any:
        """Of an array (height, width, components), to be fetched texel by texel."""
        upload, internal = UPLOADS[array.dtype.name]
        texture = self.context.texture(
            array.shape[1::-1], array.shape[2], np.ascontiguousarray(array), dtype=upload,
            internal_format=internal,
        )  # fmt: skip
        texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        return texture

    def light(self, lobes: Lobes) -> None:
        """Take a light of lobes for three colours: axes (3, N, 3), coefficients (3, N, n).

        Raises:
            ValueError: they are too many, or of another order.
        """
        colours, count, order = lobes.coefficients.shape
        most = most_lobes(self.order)
        if colours != 3 or count > most or order != self.order:
            raise ValueError(f"{colours} x {count} lobes of order {order} do not fit the shader")
        axes = np.zeros((3, most, 3), dtype="f4")
        zonal = np.zeros((3, most, order), dtype="f4")
        axes[:, :count], zonal[:, :count] = lobes.axes, lobes.coefficients
        axes[:, count:, 2] = 1.0
        self._set("axis", axes)
        self._set("zonal", zonal)
        self._set("lobes", count)

    def show_bands(self, order: int) -> None:
        """Cut light and visibility to so many bands when drawing; 0 for all there are."""
        self._set("bands", min(order, self.order) or self.order)

    def material(self, operator: ReflectionOperator) -> None:
        """Take a material.

        Raises:
            ValueError: it is of another order.
        """
        if operator is self._material:
            return
        factors, size, _ = operator.matrices.shape
        coefficients = operator.view.shape[1]
        if operator.order != self.order or coefficients > size:
            raise ValueError(f"an operator of order {operator.order} does not fit the shader")
        matrices = np.zeros((factors, size, 4 * self.texels), dtype="f4")
        matrices[..., :size] = operator.matrices
        view = np.zeros((factors, coefficients, 4), dtype="f4")
        view[..., :3] = operator.view
        for name in ("matrices", "view_factors"):
            if name in self._held:
                self._held.pop(name).release()
        self._held["matrices"] = self._texture(matrices.reshape(factors * size, self.texels, 4))
        self._held["view_factors"] = self._texture(view)
        self._material = operator
        self._set("factors", factors)
        self._set("view_coefficients", coefficients)

    def draw(self, frame: Any, matrix: FloatArray, eye: FloatArray) -> None:
        """Draw into a framebuffer over what is there; its depth is tested.

        Args:
            frame: of OpenGL.
            matrix: world to clip space, (4, 4), as ``Camera.matrix``.
            eye: where the camera is, (3,).
        """
        frame.use()
        self.context.enable_only(moderngl.DEPTH_TEST)
        self._set("view_projection", np.asarray(matrix).T)
        self._set("eye", np.asarray(eye))
        self._bind()
        with self._timer:
            self._mesh.render(moderngl.TRIANGLES)
        if self._timer.milliseconds is not None:
            self.milliseconds["draw"] = self._timer.milliseconds

    def _bind(self) -> None:
        """Every texture to its unit."""
        for unit, name in enumerate(TEXTURES):
            texture = self._held.get(name) or self._held.get("front_visibility")
            if texture is not None:
                texture.use(unit)
