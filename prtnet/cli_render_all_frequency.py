"""The work of ``prtnet render`` of all-frequency fields: an object under a sharp light that turns.

Beside ``prtnet.cli``, which it serves, it may import the other packages.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from tyro.conf import Positional

from prtnet.all_frequency_file import facts, load_fields
from prtnet.cli_arguments import refuse
from prtnet.cli_options import CAMERA_BOUNDS, NO_MOVIE, check_bounds, check_pictures
from prtnet.cores import use_threads
from prtnet.cube_map import segment_coefficients
from prtnet.environment import about_up, environment
from prtnet.errors import PrtnetError
from prtnet.limits import MOST_PIXELS, check_side
from prtnet.truncation import area_weights, transfer_weights, truncated
from prtnet.turning_light import TurningLight

if TYPE_CHECKING:
    from prtnet.all_frequency import AllFrequencyField
    from prtnet.arrays import FloatArray
    from prtnet.console import Console

__all__ = ["AllFrequencyOptions", "make_all_frequency_pictures"]

SAMPLES = 4  # a pixel
BOUNDS = CAMERA_BOUNDS | {"keep": (1, 1e6)}


@dataclass(frozen=True)
class AllFrequencyOptions:
    """Options of ``prtnet render`` of a field of all-frequency transfer."""

    field: Positional[Path]  # from prtnet bake-all-frequency
    out: Path  # picture to write, .png, or with --spin a movie, .mp4
    light: str = "studio"  # an .hdr or .exr picture of a light, or the name of a preset
    light_turn: float = 0.0  # turn the light about the vertical by so many degrees
    keep: int | None = None  # so many wavelets of the light, of 6 n²; all when not given
    # The largest, or weighed by what they cover, or by what the object makes of them.
    keep_by: Literal["magnitude", "area", "transfer"] = "magnitude"
    alone: bool = False  # show the object without what stands beside it
    size: tuple[int, int] = (640, 640)  # of the picture, in pixels
    azimuth: float = 30.0  # of the camera: degrees to the left of the object from in front
    elevation: float = 12.0  # of the camera: degrees above the horizon
    zoom: float = 1.0  # how many times closer than what shows the whole object
    exposure: float = 0.0  # stops brighter
    spin: int | None = None  # so many pictures all around, OUT with a number before its .png
    spins: Literal["camera", "light"] = "camera"  # what goes around
    fps: int = 30  # pictures a second of a movie
    renderer: Literal["gl", "cpu"] | None = None  # OpenGL or NumPy; OpenGL where there is one
    threads: int | None = None  # CPU threads; all cores when not given

    def __post_init__(self) -> None:
        """Refuse values that cannot work."""
        check_bounds(self, BOUNDS)
        check_side("--size", self.size, MOST_PIXELS)
        check_pictures(self.out, self.spin)
        if self.keep is None and self.keep_by != "magnitude":
            raise PrtnetError("--keep", "is missing: say how many wavelets of the light are kept")
        if self.spin is None and (self.moving or self.spins == "light"):
            raise PrtnetError("--spin", "is missing: say how many pictures go all around")

    def refuse_idle(self, named: Mapping[str, str]) -> None:
        """Refuse options that would do nothing, of those named as ``named_options`` tells."""
        refuse(named, {} if self.moving else {"fps": NO_MOVIE})

    @property
    def moving(self) -> bool:
        """Whether a movie is wanted."""
        return self.out.suffix.lower() == ".mp4"

    def inputs(self) -> list[Path]:
        """The files that are read."""
        light = Path(self.light)
        return [self.field, *([light] if light.is_file() else [])]


def make_all_frequency_pictures(
    options: AllFrequencyOptions, threads: int, console: Console
) -> dict[str, Any]:
    """Write the picture, pictures or movie; facts about them.

    Raises:
        PrtnetError: the file is none, there is no such light, or a picture cannot be written.
    """
    from runtime.all_frequency_shot import framing, opened
    from runtime.draw import averaged, finer, usable
    from runtime.picture import auto_exposure, develop
    from runtime.reel import opened_reel, reel, saved_frames

    use_threads(threads)
    fields = shown(options)
    source = environment(options.light)
    aspect = options.size[0] / options.size[1]
    angles = np.radians([options.azimuth, options.elevation]).tolist()
    camera = framing(fields, aspect, *angles).nearer(options.zoom)
    frames = reel(options.out, options.spin, 0.0, ())
    turns, exposure = options.spins == "light", 0.0  # one exposure for all pictures
    with contextlib.ExitStack() as held:
        renderer = options.renderer or usable(console.message)
        size = finer(options.size, SAMPLES)
        drawer = held.enter_context(opened(fields, renderer, size))
        report = held.enter_context(console.progress())
        report("light", 0, 0)
        light = TurningLight(source, fields[0].size)
        weights = importance(options, fields)
        write = held.enter_context(opened_reel(options.out, options.fps))
        for number, frame in enumerate(frames):
            report("pictures", number, len(frames))
            if number == 0 or turns:
                turn = options.light_turn + (math.degrees(frame.turn) if turns else 0.0)
                shining = segment_coefficients(light.at(about_up(turn)))
                if options.keep is not None:
                    shining = truncated(shining, options.keep, weights)
                drawer.light(shining)
            seen = camera if turns else camera.around(frame.turn)
            fine = drawer.draw(seen.matrix(aspect), np.asarray(seen.eye))
            linear = averaged(fine, options.size)
            exposure = exposure or auto_exposure(linear)
            write(frame, develop(linear, exposure * 2.0**options.exposure))
    out = saved_frames(frames, options.out)
    return {"out": out, **facts(fields), "size": options.size, "pictures": len(frames)}


def importance(
    options: AllFrequencyOptions, fields: Sequence[AllFrequencyField]
) -> FloatArray | None:
    """What magnitudes of wavelets are weighed by."""
    if options.keep is None or options.keep_by == "magnitude":
        return None
    by_area = options.keep_by == "area"
    return area_weights(fields[0].size) if by_area else transfer_weights(fields)


def shown(options: AllFrequencyOptions) -> tuple[AllFrequencyField, ...]:
    """The fields of the file, or the object alone."""
    fields = load_fields(options.field)
    return fields[:1] if options.alone else fields
