"""The same picture by OpenGL, without a window: EGL, GLSL 3.30, nothing beyond WebGL 2's reach.

The vertex shader fetches its vertex's transfer vector from a 2-D float texture, four coefficients a
texel, and multiplies it with the light: the dot product an engine does. Colours stay linear floats
until they are read back.
"""

from __future__ import annotations

import contextlib
from types import TracebackType
from typing import Any, Self

import moderngl
import numpy as np

from prtnet.arrays import FloatArray
from prtnet.errors import PrtnetError
from prtnet.one_dimensional import OneDimensional
from prtnet.reflection import ReflectionOperator
from prtnet.zh import Lobes
from runtime.camera import Camera
from runtime.material_shader import FRAGMENT_SHADER
from runtime.one_dimensional import LobeSubject
from runtime.one_dimensional_stage import OneDimensionalStage
from runtime.reflected import Subject
from runtime.shading import Surface
from runtime.stage import TEXTURE_WIDTH, Stage

__all__ = ["GLRenderer", "available", "check_size", "create_context", "framed", "pixels_of"]

VERTEX_SHADER = """#version 330
const int TEXELS = $TEXELS;  // of one vertex, four coefficients each
const int COLUMNS = $COLUMNS;  // vertices in a row of the texture

uniform mat4 view_projection;
uniform sampler2D front_transfer;
uniform sampler2D back_transfer;
uniform vec3 light[4 * TEXELS];  // times albedo / pi

in vec3 position;
out vec3 front;
out vec3 back;

vec3 radiance(sampler2D transfer) {
    ivec2 first = ivec2((gl_VertexID % COLUMNS) * TEXELS, gl_VertexID / COLUMNS);
    vec3 sum = vec3(0.0);
    for (int k = 0; k < TEXELS; ++k) {
        vec4 t = texelFetch(transfer, first + ivec2(k, 0), 0);
        sum += t.x * light[4 * k] + t.y * light[4 * k + 1]
             + t.z * light[4 * k + 2] + t.w * light[4 * k + 3];
    }
    return sum;
}

void main() {
    front = radiance(front_transfer);
    back = radiance(back_transfer);
    gl_Position = view_projection * vec4(position, 1.0);
}
"""


def create_context() -> moderngl.Context:
    """A context without a window.

    Raises:
        PrtnetError: there is no usable EGL.
    """
    try:
        settings: dict[str, Any] = {"backend": "egl"}
        return moderngl.create_context(require=330, standalone=True, **settings)
    except Exception as error:  # glcontext raises bare Exception, OSError and ImportError
        raise PrtnetError(
            "--renderer gl",
            f"OpenGL 3.3 through EGL is not available ({error}); install it with "
            "scripts/system-gl.sh (Debian: libegl1 libgl1-mesa-dri) or use --renderer cpu",
        ) from error


def available() -> bool:
    """Whether ``GLRenderer`` can be used here."""
    try:
        create_context().release()
    except PrtnetError:
        return False
    return True


class GLRenderer:
    """Draws surfaces headless; a context manager that gives everything back at its end.

    Raises:
        PrtnetError: there is no usable EGL.
    """

    def __init__(self) -> None:
        self._context = create_context()
        self._programs: dict[int, Any] = {}
        self._stages: dict[int, Stage] = {}
        self._closed = False
        self._lobed: dict[tuple[int, int], OneDimensionalStage] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Release the context and all that lives in it; once is enough."""
        if self._closed:
            return
        self._closed = True
        with self._context:
            for held in (self._programs, self._stages, self._lobed):
                for one in held.values():
                    one.release()
                held.clear()
        self._context.release()

    def draw(
        self, surface: Surface, light: FloatArray, matrix: FloatArray, size: tuple[int, int]
    ) -> FloatArray:
        """Shade every vertex with ``transfer · light`` and draw the mesh, both sides.

        Args:
            surface: the mesh and its transfer.
            light: SH coefficients times albedo / π, (n², 3).
            matrix: world to clip space, (4, 4), as ``Camera.matrix``.
            size: width and height in pixels.

        Returns:
            (H, W, 4) float32, top row first: linear colour, 0 where nothing is, and coverage.

        Raises:
            PrtnetError: the picture or the mesh is larger than this OpenGL can hold.
        """
        limit = check_size(self._context, size)
        texels = texels_of(surface.transfer)
        if -(-len(surface.positions) // (TEXTURE_WIDTH // texels)) > limit:
            message = f"{len(surface.positions)} vertices do not fit a texture"
            raise PrtnetError("--renderer gl", message + "; use --renderer cpu")
        with self._context, contextlib.ExitStack() as made:
            program = self._program(texels)
            program["view_projection"].write(matrix.T.astype("f4").tobytes())
            padded = np.zeros((4 * texels, 3), dtype="f4")
            padded[: len(light)] = light
            program["light"].write(padded.tobytes())
            self._bind_transfer(program, surface, made)
            return self._rasterise(program, surface, size, made)

    def draw_material(
        self,
        subject: Subject,
        lobes: Lobes,
        operator: ReflectionOperator,
        camera: Camera,
        size: tuple[int, int],
        order: int = 0,
    ) -> FloatArray:
        """Shade and draw a subject of any material, both sides; see ``draw``.

        Args:
            subject: the mesh, its visibility and frames.
            lobes: of light of three colours, world frame.
            operator: the material.
            camera: where from.
            size: width and height in pixels.
            order: bands of light and visibility to show; 0 for all there are.
        """
        check_size(self._context, size)
        whole = operator.order
        with self._context, contextlib.ExitStack() as made:
            if whole not in self._stages:
                self._stages[whole] = Stage(self._context, whole)
            stage = self._stages[whole]
            stage.show_bands(order)
            stage.show(subject)
            stage.light(lobes)
            stage.material(operator)
            return self._drawn(stage, camera, size, made)

    def draw_lobes(
        self,
        subject: LobeSubject,
        lobes: Lobes,
        material: OneDimensional,
        camera: Camera,
        size: tuple[int, int],
    ) -> FloatArray:
        """The same of a 1D BRDF on visibility in lobes, of the light's order."""
        check_size(self._context, size)
        key = subject.front.visibility.coefficients.shape[:0:-1]  # order, lobes
        with self._context, contextlib.ExitStack() as made:
            if key not in self._lobed:
                self._lobed[key] = OneDimensionalStage(self._context, *key)
            stage = self._lobed[key]
            stage.show(subject)
            stage.light(lobes)
            stage.material(material)
            return self._drawn(stage, camera, size, made)

    def _drawn(
        self,
        stage: Stage | OneDimensionalStage,
        camera: Camera,
        size: tuple[int, int],
        made: contextlib.ExitStack,
    ) -> FloatArray:
        """What a stage shows, through a camera."""
        frame = framed(self._context, size, made)
        stage.draw(frame, camera.matrix(size[0] / size[1]), np.asarray(camera.eye))
        return pixels_of(frame, size)

    def _program(self, texels: int) -> Any:
        if texels not in self._programs:
            columns = TEXTURE_WIDTH // texels
            vertex = VERTEX_SHADER.replace("$TEXELS", str(texels))
            self._programs[texels] = self._context.program(
                vertex_shader=vertex.replace("$COLUMNS", str(columns)),
                fragment_shader=FRAGMENT_SHADER,
            )
        return self._programs[texels]

    def _bind_transfer(self, program: Any, surface: Surface, made: contextlib.ExitStack) -> None:
        for unit, (name, transfer) in enumerate(
            [("front_transfer", surface.transfer), ("back_transfer", surface.back_transfer)]
        ):
            program[name] = unit if transfer is not None else 0
            if transfer is not None:
                data = texture_data(transfer)
                texture = self._context.texture(data.shape[1::-1], 4, data.tobytes(), dtype="f4")
                made.callback(texture.release)
                texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
                texture.use(unit)

    def _rasterise(
        self, program: Any, surface: Surface, size: tuple[int, int], made: contextlib.ExitStack
    ) -> FloatArray:
        context = self._context
        positions = context.buffer(np.ascontiguousarray(surface.positions, dtype="f4").tobytes())
        made.callback(positions.release)
        indices = context.buffer(np.ascontiguousarray(surface.faces, dtype="i4").tobytes())
        made.callback(indices.release)
        mesh = context.vertex_array(program, [(positions, "3f", "position")], indices)
        made.callback(mesh.release)
        frame = framed(self._context, size, made)
        context.enable_only(moderngl.DEPTH_TEST)
        mesh.render(moderngl.TRIANGLES)
        return pixels_of(frame, size)


def check_size(context: moderngl.Context, size: tuple[int, int]) -> int:
    """The largest texture's side.

    Raises:
        PrtnetError: a picture of this size is larger.
    """
    limit = int(context.info["GL_MAX_TEXTURE_SIZE"])
    if max(size) > limit:
        message = f"{size[0]}x{size[1]} is more than this OpenGL draws ({limit}); ask for less"
        raise PrtnetError("--size", message)
    return limit


def framed(context: moderngl.Context, size: tuple[int, int], made: contextlib.ExitStack) -> Any:
    """A framebuffer of linear colour and depth, cleared and in use; ``made`` gives it back."""
    colour = context.texture(size, 4, dtype="f4")
    made.callback(colour.release)
    depth = context.depth_renderbuffer(size)
    made.callback(depth.release)
    frame = context.framebuffer([colour], depth)
    made.callback(frame.release)
    frame.use()
    frame.clear(0.0, 0.0, 0.0, 0.0, depth=1.0)
    return frame


def pixels_of(frame: Any, size: tuple[int, int]) -> FloatArray:
    """(H, W, 4) float32 of a framebuffer, top row first: OpenGL's first is the lowest."""
    pixels = np.frombuffer(frame.read(components=4, dtype="f4"), dtype="f4")
    return pixels.reshape(size[1], size[0], 4)[::-1].copy()


def texels_of(transfer: FloatArray) -> int:
    """Texels that hold one vertex's vector."""
    return -(-transfer.shape[1] // 4)


def texture_data(transfer: FloatArray) -> FloatArray:
    """Transfer vectors (V, n²) laid out as a texture (rows, width, 4) of whole vertices a row."""
    count, coefficients = transfer.shape
    texels = texels_of(transfer)
    columns = TEXTURE_WIDTH // texels
    rows = -(-count // columns)
    data = np.zeros((rows * columns, 4 * texels), dtype="f4")
    data[:count, :coefficients] = transfer
    return data.reshape(rows, columns * texels, 4)
