"""One picture of a surface, by OpenGL or by NumPy: the same camera, samples and light."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Literal, Protocol

import numpy as np

from prtnet.arrays import FloatArray
from prtnet.errors import PrtnetError, nearest_name
from prtnet.one_dimensional import OneDimensional
from prtnet.reflection import ReflectionOperator
from prtnet.zh import Lobes
from runtime.camera import Camera
from runtime.looks import cut_lobes, cut_visibility
from runtime.one_dimensional import LobeSubject, side_radiance
from runtime.rasteriser import rasterise
from runtime.reflected import Side, Subject, outgoing_radiance
from runtime.shading import Surface, reflected_light

__all__ = [
    "Renderer",
    "RendererName",
    "averaged",
    "finer",
    "opened",
    "render",
    "render_colours",
    "render_lobes",
    "render_material",
    "usable",
]

SIDE_LIMIT = 1 << 14  # samples; also what OpenGL and the rasteriser's integers can hold
SAMPLE_LIMIT = 1 << 26

RendererName = Literal["gl", "cpu"]


class Renderer(Protocol):
    """What both ways of drawing offer; see ``GLRenderer.draw``."""

    def draw(
        self, surface: Surface, light: FloatArray, matrix: FloatArray, size: tuple[int, int]
    ) -> FloatArray:
        """Linear colour and coverage, (H, W, 4) float32, one sample at every pixel's centre."""
        ...

    def draw_material(
        self,
        subject: Subject,
        lobes: Lobes,
        operator: ReflectionOperator,
        camera: Camera,
        size: tuple[int, int],
        order: int = 0,
    ) -> FloatArray:
        """The same of a subject of a material, under lobes of light of three colours."""
        ...

    def draw_lobes(
        self,
        subject: LobeSubject,
        lobes: Lobes,
        material: OneDimensional,
        camera: Camera,
        size: tuple[int, int],
    ) -> FloatArray:
        """The same of a subject whose visibility is lobes."""
        ...


class CPURenderer:
    """The NumPy reference."""

    def draw(
        self, surface: Surface, light: FloatArray, matrix: FloatArray, size: tuple[int, int]
    ) -> FloatArray:
        """As ``GLRenderer.draw``."""
        back = surface.back_transfer
        return rasterise(
            surface.positions,
            surface.faces,
            surface.transfer @ light,
            matrix,
            size,
            None if back is None else back @ light,
        )

    def draw_material(
        self,
        subject: Subject,
        lobes: Lobes,
        operator: ReflectionOperator,
        camera: Camera,
        size: tuple[int, int],
        order: int = 0,
    ) -> FloatArray:
        """As ``GLRenderer.draw_material``."""
        eye, lobes = np.asarray(camera.eye), cut_lobes(lobes, order)
        shown = [Side(cut_visibility(one.visibility, order), one.frames) for one in subject.sides]
        colours = [
            outgoing_radiance(subject.positions, side, eye, lobes, operator) for side in shown
        ]
        return rasterised(subject, colours, camera, size)

    def draw_lobes(
        self,
        subject: LobeSubject,
        lobes: Lobes,
        material: OneDimensional,
        camera: Camera,
        size: tuple[int, int],
    ) -> FloatArray:
        """As ``GLRenderer.draw_lobes``."""
        colours = side_radiance(subject, np.asarray(camera.eye), lobes, material)
        return rasterised(subject, colours, camera, size)


def rasterised(
    subject: Subject | LobeSubject,
    colours: Sequence[FloatArray],
    camera: Camera,
    size: tuple[int, int],
) -> FloatArray:
    """A mesh with colours (V, 3) of its front, and of its back where there are any."""
    matrix = camera.matrix(size[0] / size[1])
    back = colours[1] if len(colours) > 1 else None
    return rasterise(subject.positions, subject.faces, colours[0], matrix, size, back)


@contextlib.contextmanager
def opened(name: str) -> Iterator[Renderer]:
    """The renderer of that name, 'gl' or 'cpu', for as many pictures as wanted.

    Raises:
        PrtnetError: there is none of that name, or OpenGL is not available.
    """
    if name == "cpu":
        yield CPURenderer()
    elif name == "gl":
        from runtime.gl import GLRenderer  # OpenGL is loaded where it is wanted

        with GLRenderer() as renderer:
            yield renderer
    else:
        raise PrtnetError("--renderer", f"'{name}' is unknown; {nearest_name(name, ['gl', 'cpu'])}")


def usable(say: Callable[[str], None]) -> RendererName:
    """'gl' where OpenGL works; otherwise 'cpu', and a word about it."""
    from runtime.gl import available

    if available():
        return "gl"
    say("OpenGL is not available: drawing with NumPy; run scripts/system-gl.sh to install it")
    return "cpu"


def render(
    renderer: Renderer,
    surface: Surface,
    light: FloatArray,
    camera: Camera,
    size: tuple[int, int],
    albedo: float | FloatArray = 0.8,
    samples: int = 4,
) -> FloatArray:
    """A picture of a diffuse surface under a distant light.

    Args:
        renderer: from ``opened``.
        surface: the mesh and its transfer.
        light: SH coefficients of the environment's radiance, (n², 3) linear RGB.
        camera: where from.
        size: width and height in pixels.
        albedo: a number or linear RGB (3,).
        samples: a pixel, a square number: 4 draws at twice the size and averages.

    Returns:
        (H, W, 4) float32, top row first: linear colour times coverage, and coverage.

    Raises:
        PrtnetError: the picture is too large.
    """
    fine = renderer.draw(
        surface,
        reflected_light(light, albedo),
        camera.matrix(size[0] / size[1]),
        finer(size, samples),
    )
    return averaged(fine, size)


def render_colours(
    renderer: Renderer, surface: Surface, camera: Camera, size: tuple[int, int]
) -> FloatArray:
    """A picture of a surface whose transfer is the linear colour of every vertex, as ``render``."""
    return render(renderer, surface, math.pi * np.eye(3), camera, size, albedo=1.0)


def render_material(
    renderer: Renderer,
    subject: Subject,
    lobes: Lobes,
    operator: ReflectionOperator,
    camera: Camera,
    size: tuple[int, int],
    samples: int = 4,
    order: int = 0,
) -> FloatArray:
    """A picture of a subject of any material under a distant light.

    Args:
        renderer: from ``opened``.
        subject: the mesh, its visibility and frames.
        lobes: of light of three colours, world frame: axes (3, N, 3), coefficients (3, N, n).
        operator: the material, of the order of visibility.
        camera: where from.
        size: width and height in pixels.
        samples: a pixel, a square number: 4 draws at twice the size and averages.
        order: bands of light and visibility to show; 0 for all there are.

    Returns:
        As ``render``.

    Raises:
        PrtnetError: the picture is too large.
    """
    fine = renderer.draw_material(subject, lobes, operator, camera, finer(size, samples), order)
    return averaged(fine, size)


def render_lobes(
    renderer: Renderer,
    subject: LobeSubject,
    lobes: Lobes,
    material: OneDimensional,
    camera: Camera,
    size: tuple[int, int],
    samples: int = 4,
) -> FloatArray:
    """As ``render_material``, of a 1D BRDF on visibility in lobes."""
    fine = renderer.draw_lobes(subject, lobes, material, camera, finer(size, samples))
    return averaged(fine, size)


def finer(size: tuple[int, int], samples: int) -> tuple[int, int]:
    """The size of a picture of one sample a pixel, from which the wanted one is averaged."""
    width, height = size
    scale = round(samples**0.5)
    if scale < 1 or scale * scale != samples:
        raise ValueError(f"samples must be a square number, not {samples}")
    if max(width, height) * scale > SIDE_LIMIT or width * height * samples > SAMPLE_LIMIT:
        raise PrtnetError(
            "--size", f"{width}x{height} is too large a picture; use 4096x4096 at most"
        )
    return width * scale, height * scale


def averaged(fine: FloatArray, size: tuple[int, int]) -> FloatArray:
    """Means of the samples of every pixel."""
    width, height = size
    scale = len(fine) // height
    rows = np.add.reduceat(fine, np.arange(0, height * scale, scale), axis=0)
    columns = np.add.reduceat(rows, np.arange(0, width * scale, scale), axis=1)
    return np.asarray(columns / np.float32(scale * scale))
