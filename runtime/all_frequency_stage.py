"""All-frequency transfer on an OpenGL context: the object stays, a light and an eye are taken anew.

When the light changes products are made on the CPU and summed at vertices; when only the eye moves,
nothing but view factors is looked up again.
"""

from __future__ import annotations

import time
from typing import Any, Literal

import moderngl
import numpy as np

from prtnet.all_frequency import AllFrequencyField
from prtnet.arrays import FloatArray
from prtnet.errors import PrtnetError
from prtnet.glsl import texture
from runtime.all_frequency_products import Products, Sums, vertex_runs
from runtime.all_frequency_shader import (
    columns_of,
    draw_shaders,
    product_texels,
    run_textures,
    seen_shaders,
    sum_shaders,
)
from runtime.holding import Holding

__all__ = ["AllFrequencyStage", "draws_in_software"]

SOFTWARE = ("llvmpipe", "softpipe", "swiftshader")


def draws_in_software(context: moderngl.Context) -> bool:
    """Whether this OpenGL runs on the CPU."""
    name = str(context.info["GL_RENDERER"]).lower()
    return any(one in name for one in SOFTWARE)


class AllFrequencyStage(Holding):
    """One field under one light.

    Args:
        context: that everything lives in; it must be current.
        field: what is drawn.
        summed: where products are summed at vertices; on the GPU unless OpenGL runs on the CPU,
            whose own threads are several times as fast.

    Attributes:
        milliseconds: of the last light on the CPU, by name.

    Raises:
        PrtnetError: it does not fit the textures of this OpenGL.
    """

    def __init__(
        self,
        context: moderngl.Context,
        field: AllFrequencyField,
        summed: Literal["gpu", "cpu"] | None = None,
    ) -> None:
        super().__init__(context)
        self.field = field
        self.milliseconds: dict[str, float] = {}
        self.products = Products(field)
        on_cpu = summed == "cpu" or (summed is None and draws_in_software(context))
        self._sums = Sums(field) if on_cpu else None
        self._eye: tuple[float, ...] | None = None  # that radiances are held for
        self._columns = columns_of(field.rows)
        try:
            self._upload()
            if not on_cpu:
                self._upload_runs()
        except BaseException:
            self.release()
            raise

    def _upload(self) -> None:
        """The mesh, its view factors, and room for sums."""
        field, context, rows = self.field, self.context, self.field.rows
        height = max(1, -(-len(field) // self._columns))
        # OpenGL need not draw into textures of three channels.
        channels = 4 if self._sums is None else 3
        self._staged = np.zeros((height, self._columns * rows, channels), dtype=np.float32)
        self._texture("sums", self._staged)
        cells = round(field.view.shape[1] ** 0.5)
        factors = np.ones((rows, cells, cells, 4), dtype=np.float16)
        factors[..., :3] = field.view.reshape(rows, cells, cells, 3)
        self._check(cells, cells, rows)
        layers: Any = context.texture_array((cells, cells, rows), 4, factors.tobytes(), dtype="f2")
        self._held["view_factors"] = layers
        layers.filter, layers.repeat_x, layers.repeat_y = (moderngl.LINEAR,) * 2, False, False
        surface = field.surface
        parts = {"positions": surface.positions, "tangents": surface.tangents,
                 "normals": surface.normals}  # fmt: skip
        for name, part in parts.items():
            self._texture(name, texture(part.astype(np.float32)))
        self._texture("radiances", texture(np.zeros((len(field), 4), dtype=np.float32)))
        self._seen = self._keep(context.framebuffer([self._held["radiances"]]))
        self._seeing: Any = self._keep(context.program(*seen_shaders(rows)))
        self._seeing["rows"], self._seeing["vertices"] = rows, len(field)
        self._all_seen = self._keep(context.vertex_array(self._seeing, []))
        kept: dict[str, Any] = {"position": surface.positions, "faces": surface.faces}
        for name, array in kept.items():
            self._held[name] = context.buffer(reserve=max(1, array.nbytes))
            self._held[name].write(np.ascontiguousarray(array))
        self.program: Any = self._keep(context.program(*draw_shaders()))
        attributes = [(self._held["position"], "3f", "position")]
        self._mesh = context.vertex_array(self.program, attributes, self._held["faces"])

    def _upload_runs(self) -> None:
        """What sums products on the GPU."""
        runs = vertex_runs(self.field)
        empty = np.zeros((self.products.count, self.field.rows, 3), dtype=np.float32)
        for name, texels in {**run_textures(runs), "products": product_texels(empty)}.items():
            self._texture(name, texels)
        self._summing: Any = self._keep(self.context.program(*sum_shaders(self.field.rows)))
        self._summing["vertices"] = len(self.field)
        self._summing["texels"] = -(-runs.weights.shape[1] // 4)
        self._triangle = self._keep(self.context.vertex_array(self._summing, []))
        self._frame = self._keep(self.context.framebuffer([self._held["sums"]]))

    def _texture(self, name: str, texels: Any) -> None:
        """A texture (height, width, channels) to be fetched texel by texel."""
        self._check(*texels.shape[1::-1])
        kind = {"float32": "f4", "int32": "i4", "int16": "i2"}[texels.dtype.name]
        data = np.ascontiguousarray(texels).tobytes()
        made = self.context.texture(texels.shape[1::-1], texels.shape[2], data, dtype=kind)
        made.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self._held[name] = made

    def _check(self, width: int, height: int, layers: int = 1) -> None:
        """Refuse what no texture of this OpenGL holds."""
        info = self.context.info
        side, most = int(info["GL_MAX_TEXTURE_SIZE"]), int(info["GL_MAX_ARRAY_TEXTURE_LAYERS"])
        if max(width, height) > side or layers > most:
            what = f"needs {layers} textures of {width}x{height}, more than OpenGL holds here"
            raise PrtnetError("--renderer gl", f"{what}; use --renderer cpu")

    def light(self, coefficients: FloatArray) -> None:
        """Take a light: Haar coefficients of its segments, (24, (n/2)², 3)."""
        self._eye = None
        watch = [time.perf_counter()]
        products = self.products(coefficients)
        watch.append(time.perf_counter())
        if self._sums is None:
            self._held["products"].write(product_texels(products))
            self._fill(self._frame, self._summing, self._triangle)
        else:
            sums = self._sums(products)
            watch.append(time.perf_counter())
            self._staged.reshape(-1, *sums.shape[1:])[: len(sums)] = sums
            self._held["sums"].write(self._staged)
        watch.append(time.perf_counter())
        names = ("products", "sums", "upload") if self._sums else ("products", "upload")
        spent = zip(names, np.diff(watch).tolist(), strict=True)
        self.milliseconds = {name: 1e3 * seconds for name, seconds in spent}

    def draw(self, frame: Any, matrix: FloatArray, eye: FloatArray) -> None:
        """Draw into a framebuffer with depth, which is not cleared.

        Args:
            frame: to draw into.
            matrix: world to clip space, (4, 4).
            eye: where from, (3,).
        """
        own = tuple(float(one) for one in eye)
        if own != self._eye:
            self._seeing["eye"] = own
            self._fill(self._seen, self._seeing, self._all_seen)
            self._eye = own
        frame.use()
        self.program["view_projection"].write(matrix.T.astype("f4").tobytes())
        self._bind(self.program)
        self.context.enable_only(moderngl.DEPTH_TEST)
        self._mesh.render(moderngl.TRIANGLES)

    def _fill(self, frame: Any, program: Any, triangle: Any) -> None:
        """Run a program for every texel of a framebuffer."""
        frame.use()
        self.context.enable_only(moderngl.NOTHING)
        self._bind(program)
        triangle.render(moderngl.TRIANGLES, vertices=3)

    def _bind(self, program: Any) -> None:
        """The textures that a program reads."""
        read = [
            name for name in self._held if isinstance(program.get(name, None), moderngl.Uniform)
        ]
        for unit, name in enumerate(read):
            self._held[name].use(unit)
            program[name] = unit
