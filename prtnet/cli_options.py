"""The commands' own options, apart from the configurations of the packages they drive."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from prtnet.errors import PrtnetError
from prtnet.storage import Storage

__all__ = [
    "Common",
    "DemoOptions",
    "EvaluateOptions",
    "ExportOptions",
    "GenerateFiles",
    "InfoOptions",
    "RenderOptions",
    "ReportOptions",
    "TrainOptions",
    "ViewOptions",
    "fraction_of",
]


MOST_LOBES, MOST_FACTORS = 11, 64  # what shaders are made for


def at_least(option: str, value: float | None, least: float) -> None:
    """Refuse a number that is too small, or none."""
    if value is not None and not (value >= least and math.isfinite(value)):
        raise PrtnetError(option, f"is {value:g}; it must be a number, at least {least:g}")


def fits_a_shader(lobes: int | None, factors: int) -> None:
    """Refuse more of either than shaders are made for."""
    if (lobes or 0) > MOST_LOBES or factors > MOST_FACTORS:
        raise PrtnetError("--lobes and --factors", f"are at most {MOST_LOBES}, {MOST_FACTORS}")


def fraction_of(option: str, text: str | None) -> float | None:
    """The number in ``5%`` or ``0.05``.

    Raises:
        PrtnetError: it is none.
    """
    if text is None:
        return None
    number = text.strip()
    try:
        return float(number.removesuffix("%")) / (100 if number.endswith("%") else 1)
    except ValueError:
        raise PrtnetError(option, f"'{text}' is no number; write 5% or 0.05") from None


@dataclass(frozen=True)
class Common:
    """What every command understands."""

    quiet: bool = False  # show nothing but errors
    json: Path | None = None  # write machine-readable results to this file
    debug: bool = False  # show the traceback of an error


@dataclass(frozen=True)
class InfoOptions:
    """Options of ``prtnet info``."""

    file: Positional[Path]  # scene, dataset or model


@dataclass(frozen=True)
class GenerateFiles:
    """Files of ``prtnet generate``."""

    scene: Positional[Path]  # animated scene: .glb, .gltf, or a point cache .npz
    out: Path  # dataset to write, a .zarr folder


@dataclass(frozen=True)
class TrainOptions:
    """Options of ``prtnet train`` apart from those of the fit."""

    dataset: Positional[Path]  # from prtnet generate
    out: Path  # model to write, a .safetensors file
    preset: str = "default"  # where options start: default, small, fast, large, best, tiny, paper
    max_error: str | None = None  # find the smallest model expected to err less: 5% or 0.05
    max_ms: float | None = None  # find the best model that is this fast: milliseconds a pose
    max_mb: float | None = None  # find the best model that is this small: megabytes of model.onnx
    log_dir: Path | None = None  # write TensorBoard scalars and histograms into this folder
    threads: int | None = None  # CPU threads; all cores when not given

    def __post_init__(self) -> None:
        """Refuse values that cannot work."""
        at_least("--threads", self.threads, 1)


@dataclass(frozen=True)
class EvaluateOptions:
    """Options of ``prtnet evaluate``."""

    model: Positional[Path]  # from prtnet train
    data: Positional[Path]  # a dataset, or a scene to ray-trace now
    clips: tuple[str, ...] = ()  # clips or parts CLIP@START:END; all when not given
    fps: float = 5.0  # poses a second of a scene's clips
    rays: int = 512  # rays per receiver of a scene's truth
    dump: Path | None = None  # write a scene's predictions to this .npz, in the world frame
    threads: int | None = None  # CPU threads; all cores when not given

    def __post_init__(self) -> None:
        """Refuse values that cannot work."""
        at_least("--fps", self.fps, 0.01)
        at_least("--rays", self.rays, 1)
        at_least("--threads", self.threads, 1)


@dataclass(frozen=True)
class ExportOptions:
    """Options of ``prtnet export``."""

    model: Positional[Path]  # from prtnet train
    out: Path  # folder to write
    storage: Storage | None = None  # of large arrays; the model's own when not given


@dataclass(frozen=True)
class RenderOptions:
    """Options of ``prtnet render``."""

    model: Positional[Path]  # from prtnet train
    scene: Positional[Path]  # the scene it was fitted to
    out: Path  # picture to write, .png
    clip: str | None = None  # the animation; the scene's first when not given
    time: float | None = None  # seconds; the middle of the clip when not given
    light: str = "studio"  # an .hdr or .exr picture of a light, or the name of a preset
    light_turn: float = 0.0  # turn the light about the vertical by so many degrees
    dering: float = 0.0  # take ripples off a small bright light: 0.01 is mild, 0.1 strong
    lobes: int | None = None  # zonal lobes of the light, a colour; as many as it needs by default
    brdf: str = "matte"  # material: a preset, a BRDF as ggx:roughness=0.3, a MERL .binary file
    factors: int = 8  # products that a BRDF is a sum of
    size: tuple[int, int] = (640, 640)  # of the picture, in pixels
    spin: int | None = None  # so many pictures all around, OUT with a number before its .png
    compare: Literal["truth", "visibility"] | None = None  # show what is ray-traced, and the error
    rays: int = 1024  # rays per receiver of the truth
    renderer: Literal["gl", "cpu"] | None = None  # OpenGL or NumPy; OpenGL where there is one
    threads: int | None = None  # CPU threads; all cores when not given

    def __post_init__(self) -> None:
        """Refuse values that cannot work."""
        at_least("--rays", self.rays, 1)
        at_least("--threads", self.threads, 1)
        at_least("--lobes", self.lobes, 1)
        at_least("--factors", self.factors, 1)
        at_least("--light-turn", self.light_turn, -1e6)
        at_least("--dering", self.dering, 0)
        at_least("--spin", self.spin, 1)
        if (self.spin or 1) > 999:
            raise PrtnetError("--spin", "is too many; give at most 999 pictures")
        fits_a_shader(self.lobes, self.factors)
        if self.out.suffix.lower() != ".png":
            raise PrtnetError(self.out, "is no name of a PNG picture; end it in .png")
        if max(self.size) > 8192:
            raise PrtnetError("--size", "is too large; give at most 8192x8192")


@dataclass(frozen=True)
class ViewOptions:
    """Options of ``prtnet view``."""

    model: Positional[Path]  # from prtnet train
    scene: Positional[Path]  # the scene it was fitted to
    clip: str | None = None  # the animation to start with; the scene's first when not given
    light: str = "studio"  # an .hdr or .exr picture of a light, or the name of a preset
    lobes: int = 3  # zonal lobes of the light, a colour; 0 for as many as hold it exactly
    brdf: str = "matte"  # material: a preset, a BRDF as ggx:roughness=0.3, a MERL .binary file
    factors: int = 8  # products that a BRDF is a sum of
    size: tuple[int, int] = (1280, 800)  # of the window, in pixels
    out: Path = Path()  # folder of saved pictures
    rays: int = 512  # rays per receiver of the truth
    threads: int | None = None  # CPU threads; all cores when not given

    def __post_init__(self) -> None:
        """Refuse values that cannot work."""
        at_least("--rays", self.rays, 1)
        at_least("--threads", self.threads, 1)
        at_least("--lobes", self.lobes, 0)
        at_least("--factors", self.factors, 1)
        fits_a_shader(self.lobes, self.factors)
        if max(self.size) > 8192:
            raise PrtnetError("--size", "is too large; give at most 8192x8192")


@dataclass(frozen=True)
class ReportOptions:
    """Options of ``prtnet report``."""

    dataset: Positional[Path]  # from prtnet generate
    out: Path  # page to write, .html
    quick: bool = False  # the smallest of every family that fits in seconds
    light: str = "studio"  # of the pictures: a .hdr or .exr file, or the name of a preset
    renderer: Literal["gl", "cpu"] | None = None  # OpenGL or NumPy; OpenGL where there is one
    device: str = "cpu"  # where torch fits: cpu, or cuda
    threads: int | None = None  # CPU threads; all cores when not given

    def __post_init__(self) -> None:
        """Refuse values that cannot work."""
        at_least("--threads", self.threads, 1)
        if self.out.suffix.lower() not in (".html", ".htm"):
            raise PrtnetError(self.out, "is no name of a page; end it in .html")


@dataclass(frozen=True)
class DemoOptions:
    """Options of ``prtnet demo``."""

    out: Path = Path("demo")  # folder for everything it makes
