"""The commands' own options, apart from the configurations of the packages they drive."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from prtnet.errors import PrtnetError
from prtnet.limits import (
    MOST_COPIES,
    MOST_FACTORS,
    MOST_FPS,
    MOST_LIGHT_LOBES,
    MOST_PIXELS,
    MOST_SPIN,
    check_side,
)
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
    "blend_of",
    "fraction_of",
]


Look = Literal["prediction", "truth", "visibility", "open", "ambient", "error"]
RENDER_LEAST = {
    "rays": 1, "threads": 1, "lobes": 0, "order": 1, "factors": 1, "light_turn": -1e6, "dering": 0,
    "spin": 1, "fps": 1, "split": 0, "vertex": 0, "azimuth": -1e6, "elevation": -89, "zoom": 0.1,
    "exposure": -20,
}  # fmt: skip


def at_least(option: str, value: float | None, least: float) -> None:
    """Refuse a number that is too small, or none."""
    if value is not None and not (value >= least and math.isfinite(value)):
        raise PrtnetError(option, f"is {value:g}; it must be a number, at least {least:g}")


def fits_a_shader(lobes: int | None, factors: int) -> None:
    """Refuse more of either than shaders are made for."""
    if (lobes or 0) > MOST_LIGHT_LOBES or factors > MOST_FACTORS:
        most = f"{MOST_LIGHT_LOBES}, {MOST_FACTORS}"
        raise PrtnetError("--lobes and --factors", f"are at most {most}")


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


def blend_of(text: str | None) -> tuple[str, float, float] | None:
    """Clip, seconds and share of ``CLIP:SECONDS:SHARE``.

    Raises:
        PrtnetError: it is not written so, or the share is not between 0 and 1.
    """
    if text is None:
        return None
    try:
        clip, time, share = text.rsplit(":", 2)
        numbers = float(time), float(share)
    except ValueError:
        raise PrtnetError("--blend", f"'{text}' is none; write CLIP:SECONDS:SHARE") from None
    if not 0.0 <= numbers[1] <= 1.0:
        raise PrtnetError("--blend", f"a share of {share} is none; give a number from 0 to 1")
    return clip, *numbers


@dataclass(frozen=True)
class Common:
    """What every command understands."""

    quiet: bool = False  # show nothing but errors
    json: Path | None = None  # write machine-readable results to this file
    debug: bool = False  # show the traceback of an error


@dataclass(frozen=True)
class InfoOptions:
    """Options of ``prtnet info``."""

    file: Positional[Path]  # scene, dataset, model or field


@dataclass(frozen=True)
class GenerateFiles:
    """Files of ``prtnet generate``."""

    scene: Positional[Path]  # animated scene: .glb, .gltf, or a point cache .npz
    out: Path  # dataset to write, a .zarr folder
    repair: bool = False  # trace again what is damaged in --out, made by this command line before
    cluster: str | None = None  # trace on the workers of this Dask scheduler, tcp://HOST:PORT


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
    cluster: str | None = (
        None  # fit networks on the workers of this Dask scheduler, tcp://HOST:PORT
    )
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
    out: Path  # picture to write, .png, or a movie of the clip, .mp4
    clip: str | None = None  # the animation; the scene's first when not given
    time: float | None = None  # seconds; the middle of the clip when not given
    blend: str | None = None  # a pose to blend with, CLIP:SECONDS:SHARE, of share 0 to 1
    light: str = "studio"  # an .hdr or .exr picture of a light, or the name of a preset
    light_turn: float = 0.0  # turn the light about the vertical by so many degrees
    dering: float = 0.0  # take ripples off a small bright light: 0.01 is mild, 0.1 strong
    lobes: int | None = None  # zonal lobes of the light, a colour; 0 for exactly; what it needs
    order: int | None = None  # bands of light and visibility to show; the model's when not given
    # material: a preset, a BRDF as ggx:roughness=0.3, a MERL .binary file, or of models of lobes
    # lobe:exponent=20,transmitted=0.2
    brdf: str = "matte"
    factors: int = 8  # products that a BRDF is a sum of
    show: Look = "prediction"  # what to draw; truth is light traced, visibility only that is traced
    beside: Look | None = None  # what to draw on the right of a split
    split: float = 0.5  # where that is, a fraction of the width
    vertex: int | None = None  # show this vertex's visibility on a sphere
    size: tuple[int, int] = (640, 640)  # of the picture, in pixels
    azimuth: float = 30.0  # of the camera: degrees to the character's left from in front
    elevation: float = 12.0  # of the camera: degrees above the horizon
    zoom: float = 1.0  # how many times closer than what shows everything
    exposure: float = 0.0  # stops brighter
    spin: int | None = None  # so many pictures all around, OUT with a number before its .png
    fps: int = 30  # pictures a second of a movie
    compare: Literal["truth", "visibility"] | None = None  # show what is ray-traced, and the error
    rays: int = 1024  # rays per receiver of the truth
    renderer: Literal["gl", "cpu"] | None = None  # OpenGL or NumPy; OpenGL where there is one
    threads: int | None = None  # CPU threads; all cores when not given

    @property
    def moving(self) -> bool:
        """Whether a movie is wanted."""
        return self.out.suffix.lower() == ".mp4"

    def __post_init__(self) -> None:
        """Refuse values that cannot work."""
        for option, least in RENDER_LEAST.items():
            at_least(f"--{option.replace('_', '-')}", getattr(self, option), least)
        if (self.spin or 1) > MOST_SPIN:
            raise PrtnetError("--spin", f"is too many; give at most {MOST_SPIN} pictures")
        if self.split > 1.0 or abs(self.elevation) > 89.0:
            raise PrtnetError("--split and --elevation", "are at most 1, and 89 degrees")
        if self.fps > MOST_FPS or self.zoom > 100.0 or self.exposure > 20.0:
            raise PrtnetError("--fps, --zoom and --exposure", "are at most 240, 100 and 20")
        blend_of(self.blend)
        fits_a_shader(self.lobes, self.factors)
        if self.out.suffix.lower() not in (".png", ".mp4"):
            raise PrtnetError(
                self.out, "is no name of a PNG picture or of a movie; end it in .png or .mp4"
            )
        if self.moving and self.time is not None and self.spin is None:
            raise PrtnetError(
                "--time", "has no place in a movie of a whole clip; leave it out, or add --spin"
            )
        if self.compare is not None and (self.show != "prediction" or self.beside is not None):
            raise PrtnetError("--compare", "shows the prediction; leave out --show and --beside")
        check_side("--size", self.size, MOST_PIXELS)


@dataclass(frozen=True)
class ViewOptions:
    """Options of ``prtnet view``."""

    model: Positional[Path]  # from prtnet train
    scene: Positional[Path]  # the scene it was fitted to
    clip: str | None = None  # the animation to start with; the scene's first when not given
    blend: str | None = None  # a pose to blend with, CLIP:SECONDS:SHARE, of share 0 to 1
    light: str = "studio"  # an .hdr or .exr picture of a light, or the name of a preset
    lobes: int = 3  # zonal lobes of the light, a colour; 0 for as many as hold it exactly
    order: int | None = None  # bands of light and visibility to show; the model's when not given
    # material: a preset, a BRDF as ggx:roughness=0.3, a MERL .binary file, or of models of lobes
    # lobe:exponent=20,transmitted=0.2
    brdf: str = "matte"
    factors: int = 8  # products that a BRDF is a sum of
    copies: int = 1  # characters beside and behind each other, each at a moment of its own
    size: tuple[int, int] = (1280, 800)  # of the window, in pixels
    out: Path = Path()  # folder of saved pictures
    rays: int = 512  # rays per receiver of the truth
    threads: int | None = None  # CPU threads; all cores when not given

    def __post_init__(self) -> None:
        """Refuse values that cannot work."""
        at_least("--rays", self.rays, 1)
        at_least("--threads", self.threads, 1)
        at_least("--lobes", self.lobes, 0)
        at_least("--order", self.order, 1)
        at_least("--factors", self.factors, 1)
        at_least("--copies", self.copies, 1)
        if self.copies > MOST_COPIES:
            raise PrtnetError("--copies", f"are {self.copies}; at most {MOST_COPIES} are drawn")
        blend_of(self.blend)
        fits_a_shader(self.lobes, self.factors)
        check_side("--size", self.size, MOST_PIXELS)


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
    quick: bool = False  # a coarse character and few rays: seconds, to see that all of it works
