"""The commands' own options, apart from the configurations of the packages they drive."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional
from tyro.constructors import PrimitiveConstructorSpec

from prtnet.errors import PrtnetError
from prtnet.limits import (
    MOST_COPIES,
    MOST_FACTORS,
    MOST_FPS,
    MOST_LIGHT_LOBES,
    MOST_PIXELS,
    MOST_RAYS,
    MOST_SPIN,
    MOST_THREADS,
    check_side,
    check_within,
)
from prtnet.places import place
from prtnet.storage import Storage

__all__ = [
    "CAMERA_BOUNDS",
    "NO_MOVIE",
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
    "check_bounds",
    "check_pictures",
    "fraction_of",
]


Place = Annotated[
    Path,
    PrimitiveConstructorSpec(
        nargs=1,
        metavar="PATH|URL",
        instance_from_str=lambda words: place(words[0]),
        is_instance=lambda value: hasattr(value, "read_bytes"),
        str_from_instance=lambda value: [str(value)],
    ),
]
"""A dataset may be in a store."""
Look = Literal["prediction", "truth", "visibility", "open", "ambient", "error"]
VIEW_BOUNDS = {
    "lobes": (0, MOST_LIGHT_LOBES), "factors": (1, MOST_FACTORS), "order": (1, math.inf),
    "rays": (1, MOST_RAYS), "threads": (1, MOST_THREADS),
}  # fmt: skip
CAMERA_BOUNDS = {
    "light_turn": (-1e6, 1e6), "azimuth": (-1e6, 1e6), "elevation": (-89, 89), "zoom": (0.1, 100),
    "exposure": (-20, 20), "spin": (1, MOST_SPIN), "fps": (1, MOST_FPS),
    "threads": (1, MOST_THREADS),
}  # fmt: skip
RENDER_BOUNDS = {**VIEW_BOUNDS, **CAMERA_BOUNDS, "dering": (0, 1e6), "split": (0, 1),
                 "vertex": (0, math.inf)}  # fmt: skip
NO_MOVIE = "is of movies; leave it out, or end --out in .mp4"  # --fps, of a picture


def check_bounds(options: object, bounds: Mapping[str, tuple[float, float]]) -> None:
    """Refuse numbers outside of the bounds of their options.

    Raises:
        PrtnetError: there is one.
    """
    for name, (least, most) in bounds.items():
        check_within(f"--{name.replace('_', '-')}", getattr(options, name), least, most)


def check_pictures(out: Path, spin: int | None, time: float | None = None) -> None:
    """Refuse a name that is no picture's or movie's, and a moment in a movie of a whole clip.

    Raises:
        PrtnetError: it is.
    """
    if out.suffix.lower() not in (".png", ".mp4"):
        raise PrtnetError(out, "is no name of a PNG picture or of a movie; end it in .png or .mp4")
    if out.suffix.lower() == ".mp4" and time is not None and spin is None:
        told = "has no place in a movie of a whole clip; leave it out, or add --spin"
        raise PrtnetError("--time", told)


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

    file: Positional[Place]  # scene, dataset, model or field


@dataclass(frozen=True)
class GenerateFiles:
    """Files of ``prtnet generate``."""

    scene: Positional[Path]  # animated scene: .glb, .gltf, or a point cache .npz
    out: Place  # dataset to write, a .zarr folder
    repair: bool = False  # trace again what is damaged in --out, made by this command line before
    cluster: str | None = None  # trace on the workers of this Dask scheduler, tcp://HOST:PORT


@dataclass(frozen=True)
class TrainOptions:
    """Options of ``prtnet train`` apart from those of the fit."""

    dataset: Positional[Place]  # from prtnet generate
    out: Path  # model to write, a .safetensors file
    preset: str = "default"  # where options start: default, small, fast, large, best, tiny, paper
    max_error: str | None = None  # find the smallest model expected to err less: 5% or 0.05
    max_ms: float | None = None  # find the best model that is this fast: milliseconds a pose
    max_mb: float | None = None  # find the best model that is this small: megabytes of model.onnx
    log_dir: Path | None = None  # write TensorBoard scalars and histograms into this folder
    cluster: str | None = None  # fit networks on workers of this Dask scheduler, tcp://HOST:PORT
    exchange: Place | None = None  # folder or URL for finished parts, until all are: to go on with
    threads: int | None = None  # CPU threads; all cores when not given

    def __post_init__(self) -> None:
        """Refuse values that cannot work."""
        check_within("--threads", self.threads, 1, MOST_THREADS)


@dataclass(frozen=True)
class EvaluateOptions:
    """Options of ``prtnet evaluate``."""

    model: Positional[Path]  # from prtnet train
    data: Positional[Place]  # a dataset, or a scene to ray-trace now
    clips: tuple[str, ...] = ()  # clips or parts CLIP@START:END; all when not given
    fps: float = 5.0  # poses a second of a scene's clips
    rays: int = 512  # rays per receiver of a scene's truth
    dump: Path | None = None  # write a scene's predictions to this .npz, in the world frame
    threads: int | None = None  # CPU threads; all cores when not given

    def __post_init__(self) -> None:
        """Refuse values that cannot work."""
        bounds = {"fps": (0.01, 1e6), "rays": (1, MOST_RAYS), "threads": (1, MOST_THREADS)}
        check_bounds(self, bounds)


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
    # zonal lobes of the light, a colour; 0 for as many as hold it exactly; when not given few, if
    # they hold it
    lobes: int | None = None
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
        check_bounds(self, RENDER_BOUNDS)
        blend_of(self.blend)
        check_pictures(self.out, self.spin, self.time)
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
        check_bounds(self, VIEW_BOUNDS | {"copies": (1, MOST_COPIES)})
        blend_of(self.blend)
        check_side("--size", self.size, MOST_PIXELS)


@dataclass(frozen=True)
class ReportOptions:
    """Options of ``prtnet report``."""

    dataset: Positional[Place]  # from prtnet generate
    out: Path  # page to write, .html
    quick: bool = False  # the smallest of every family that fits in seconds
    light: str = "studio"  # of the pictures: a .hdr or .exr file, or the name of a preset
    renderer: Literal["gl", "cpu"] | None = None  # OpenGL or NumPy; OpenGL where there is one
    device: str = "cpu"  # where torch fits: cpu, or cuda
    threads: int | None = None  # CPU threads; all cores when not given

    def __post_init__(self) -> None:
        """Refuse values that cannot work."""
        check_within("--threads", self.threads, 1, MOST_THREADS)
        if self.out.suffix.lower() not in (".html", ".htm"):
            raise PrtnetError(self.out, "is no name of a page; end it in .html")


@dataclass(frozen=True)
class DemoOptions:
    """Options of ``prtnet demo``."""

    out: Path = Path("demo")  # folder for everything it makes
    quick: bool = False  # a coarse character and few rays: seconds, to see that all of it works
