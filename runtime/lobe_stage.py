"""A field of lobes on an OpenGL context: its textures stay, a pose and a light are written anew."""

from __future__ import annotations

from typing import Any

import moderngl
import numpy as np

from prtnet.arrays import FloatArray
from prtnet.canvas import Canvas
from prtnet.errors import PrtnetError
from prtnet.lobe_field import LobeField
from prtnet.transfer import Patch
from runtime.holding import Holding
from runtime.lobe_shader import lobe_layers, mesh_shaders, patch_shaders, vertex_texture
from runtime.lobe_shading import TABLE, LobeLight

__all__ = ["LobeStage"]

ATTRIBUTES = {"position": 3, "tangent": 3, "normal": 3, "place": 2}


class LobeStage(Holding):
    """One field, on one mesh, under one light.

    Args:
        context: that everything lives in; it must be current.
        field: what is drawn.
        by_table: lobes are looked up in the light's table; otherwise evaluated.

    Raises:
        PrtnetError: it does not fit the textures of this OpenGL.
    """

    def __init__(self, context: moderngl.Context, field: LobeField, by_table: bool = True) -> None:
        super().__init__(context)
        self.field, self.by_table = field, by_table
        self.patch = isinstance(field.layout, Patch)
        shaders = (patch_shaders if self.patch else mesh_shaders)(field, by_table)
        self.program: Any = self._keep(context.program(*shaders))
        self._shape: tuple[int, int] | None = None
        self._set("rows", field.rows)
        self._set("lobes", field.count)
        try:
            self._upload()
        except BaseException:
            self.release()
            raise

    def _upload(self) -> None:
        """Textures of the field, and room for those of light."""
        field, layout = self.field, self.field.layout
        if isinstance(layout, Patch):
            height, width = layout.heights.shape
            low, lobes = lobe_layers(field, (width, height))
            soft = moderngl.LINEAR
            self._array("low_map", low, soft, layout.tiles)
            self._array(
                "lobe_map", lobes, soft if field.coherent else moderngl.NEAREST, layout.tiles
            )
            if field.view is not None:
                normals = np.concatenate([layout.normals, np.ones((height, width, 1))], axis=-1)
                self._array("normal_map", normals[None], soft, layout.tiles, flat=True)
        else:
            self._array("points", vertex_texture(field)[None], moderngl.NEAREST, flat=True)
        if field.view is not None:
            size = round(field.view.shape[1] ** 0.5)
            factors = np.ones((field.rows, size, size, 4))
            factors[..., :3] = field.view.reshape(field.rows, size, size, 3)
            self._array("view_factors", factors, moderngl.LINEAR)
        if self.by_table:
            empty = np.zeros((field.order, TABLE[1], TABLE[0], 4))
            self._array("table", empty, moderngl.LINEAR, (True, False))

    def _array(
        self,
        name: str,
        layers: FloatArray,
        filtering: int,
        tiles: tuple[bool, bool] = (False, False),
        flat: bool = False,
    ) -> None:
        """Layers (L, H, W, 4) as a texture of halves; one alone where it is flat."""
        count, height, width, _ = layers.shape
        info = self.context.info
        side, most = int(info["GL_MAX_TEXTURE_SIZE"]), int(info["GL_MAX_ARRAY_TEXTURE_LAYERS"])
        if max(height, width) > side or count > most:
            what = f"has {count} textures of {width}x{height}, more than OpenGL holds here"
            raise PrtnetError("--renderer gl", f"{what}; use --renderer cpu")
        data = np.ascontiguousarray(layers, dtype=np.float16).tobytes()
        make: Any = self.context.texture if flat else self.context.texture_array
        size = (width, height) if flat else (width, height, count)
        made = make(size, 4, data, dtype="f2")
        self._held[name] = made
        made.filter = (filtering, filtering)
        made.repeat_x, made.repeat_y = tiles

    def light(self, light: LobeLight) -> None:
        """Take a light: its first bands, and its table or the others.

        Raises:
            ValueError: it has no table where one is wanted.
        """
        wanted = self.program["light"].array_length
        known = np.zeros((wanted, 3), dtype="f4")
        part = light.harmonics[:wanted]
        known[: len(part)] = part
        self.program["light"].write(known.tobytes())
        if not self.by_table:
            return
        if light.table is None:
            raise ValueError("lobes are looked up in a table, and the light has none")
        scale = max(float(np.abs(light.table).max()), float(np.finfo(np.float32).tiny))
        texels = np.zeros((self.field.order, TABLE[1], TABLE[0], 4), dtype=np.float16)
        texels[..., :3] = np.moveaxis(light.table / scale, 2, 0)
        self._held["table"].write(texels.tobytes())
        self._set("table_scale", scale)

    def show(self, canvas: Canvas) -> None:
        """Take a pose.

        Raises:
            ValueError: a patch has no places there, or a mesh other vertices.
        """
        if self.patch != (canvas.places is not None):
            raise ValueError("a patch needs places, and a field of vertices none")
        if not self.patch and len(canvas.positions) != len(self.field):
            raise ValueError("a field of vertices is shown on its own mesh")
        parts = {"position": canvas.positions, "tangent": canvas.tangents, "normal": canvas.normals}
        if canvas.places is not None:
            parts["place"] = canvas.places
        shape = len(canvas.positions), len(canvas.faces)
        if shape != self._shape:
            self._allocate(shape, list(parts))
        for name, part in parts.items():
            self._held[name].write(np.ascontiguousarray(part, dtype="f4"))
        self._held["faces"].write(np.ascontiguousarray(canvas.faces, dtype="i4"))

    def _allocate(self, shape: tuple[int, int], names: list[str]) -> None:
        """Buffers of a mesh of so many vertices and triangles."""
        self._drop([*names, "faces"])
        for name in names:
            self._held[name] = self.context.buffer(reserve=max(1, 4 * ATTRIBUTES[name] * shape[0]))
        self._held["faces"] = self.context.buffer(reserve=max(1, 12 * shape[1]))
        layout = [
            (self._held[name], f"{ATTRIBUTES[name]}f", name)
            for name in names
            if name in self.program
        ]
        self._mesh = self.context.vertex_array(self.program, layout, self._held["faces"])
        self._shape = shape

    def draw(self, frame: Any, matrix: FloatArray, eye: FloatArray) -> None:
        """Draw into a framebuffer with depth, which is not cleared.

        Args:
            frame: to draw into.
            matrix: world to clip space, (4, 4).
            eye: where from, (3,).
        """
        frame.use()
        self.program["view_projection"].write(matrix.T.astype("f4").tobytes())
        self._set("eye", tuple(float(one) for one in eye))
        for unit, (name, held) in enumerate(self._held.items()):
            if name in self.program and isinstance(self.program[name], moderngl.Uniform):
                held.use(unit)
                self._set(name, unit)
        self.context.enable_only(moderngl.DEPTH_TEST)
        self._mesh.render(moderngl.TRIANGLES)

    def _set(self, name: str, value: Any) -> None:
        """A uniform, unless the compiler left it out."""
        if name in self.program:
            self.program[name].value = value
