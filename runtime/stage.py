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
from runtime.lit_stage import SIDES, LitStage, fetched
from runtime.material_shader import FRAGMENT_SHADER, vertex_shader
from runtime.reflected import Side, Subject
from runtime.vertex_probe import VertexProbe

__all__ = ["Stage"]

TEXTURE_WIDTH = WIDTH
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


class Stage(LitStage):
    """One subject under one light, of one material.

    Args:
        context: that everything lives in; it must be current.
        order: bands n of visibility.
        tables: of a model, whose latents subjects are then shown with.
    """

    stay = ("matrices", "view_factors", *MODEL)

    def __init__(
        self, context: moderngl.Context, order: int, tables: GPUTables | None = None
    ) -> None:
        self.texels = -(-(order**2) // 4)
        self.columns = TEXTURE_WIDTH // self.texels
        shader = vertex_shader(order, self.columns, tables)
        program = context.program(vertex_shader=shader, fragment_shader=FRAGMENT_SHADER)
        super().__init__(context, order, program)
        self._material: ReflectionOperator | None = None
        self._tables = tables
        self._probe: VertexProbe | None = None
        self._latents: Any = None
        self._occluders: Any = None
        for unit, name in enumerate(TEXTURES):
            self._set(name, unit)
        self.show_bands(0)
        if tables is not None:
            try:
                self._take(tables)
            except BaseException:
                self.release()
                raise

    def show(self, subject: Subject) -> None:
        """Take a subject's pose.

        Raises:
            PrtnetError: it has more vertices than a texture of this OpenGL holds.
        """
        started = time.perf_counter()
        count = len(subject.positions)
        if self._rows(count) > int(self.context.info["GL_MAX_TEXTURE_SIZE"]):
            raise PrtnetError(
                "--renderer gl", f"{count} vertices do not fit a texture; use --renderer cpu"
            )
        self._pose(subject)
        if self._latents is None:
            for name, side in zip(SIDES, subject.sides, strict=False):
                self._held[f"{name}_visibility"].write(self._padded(side))
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
        self._take_pose(latents, occluders)
        self.milliseconds["upload"] += 1e3 * (time.perf_counter() - started)

    def _take_pose(self, latents: FloatArray, occluders: FloatArray | None) -> None:
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
            self._probe = self._keep(VertexProbe(self.context, self._tables, units))
        self._take_pose(latents, occluders)
        self._bind()
        return self._probe(receiver)

    def _rows(self, count: int) -> int:
        """Of a texture of so many vertices' visibility."""
        return -(-count // self.columns)

    def _allocate_side(self, name: str, count: int) -> None:
        """Visibility, or which receivers' it is."""
        if self._latents is None:
            size = self.columns * self.texels, max(1, self._rows(count))
            self._held[f"{name}_visibility"] = fetched(self.context.texture(size, 4, dtype="f4"))
        else:
            self._held[f"{name}_receivers"] = self.context.buffer(reserve=max(1, 4 * count))

    def _attributes_of_side(self, name: str, own: str) -> list[tuple[Any, ...]]:
        """The receivers, where the shader reads them."""
        read = f"{name}_receiver" in self.program
        return [(self._held[f"{own}_receivers"], "1i", f"{name}_receiver")] if read else []

    def _padded(self, side: Side) -> Any:
        """Visibility (V, n²) as whole texels and rows."""
        rows = max(1, self._rows(len(side.visibility)))
        data = np.zeros((rows * self.columns, 4 * self.texels), dtype="f4")
        data[: len(side.visibility), : self.order**2] = side.visibility
        return data.reshape(-1, self.columns * self.texels, 4)

    def _texture(self, array: Any) -> Any:
        """Of an array (height, width, components), to be fetched texel by texel."""
        upload, internal = UPLOADS[array.dtype.name]
        made = self.context.texture(
            array.shape[1::-1], array.shape[2], np.ascontiguousarray(array), dtype=upload,
            internal_format=internal,
        )  # fmt: skip
        return fetched(made)

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

    def _bind(self) -> None:
        """Every texture to its unit."""
        for unit, name in enumerate(TEXTURES):
            texture = self._held.get(name) or self._held.get("front_visibility")
            if texture is not None:
                texture.use(unit)
