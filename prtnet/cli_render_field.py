"""The work of ``prtnet render FIELD``: local transfer on its mesh, a vase, or any scene.

Beside ``prtnet.cli``, which it serves, it may import the other packages.
"""

from __future__ import annotations

import contextlib
import functools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from tyro.conf import Positional

from prtnet.array_file import LOBES, header_key
from prtnet.cli_arguments import refuse
from prtnet.cli_options import CAMERA_BOUNDS, NO_MOVIE, check_bounds, check_pictures
from prtnet.environment import environment
from prtnet.errors import PrtnetError
from prtnet.limits import MOST_LOBES, MOST_PIXELS, MOST_REPEAT, check_side

if TYPE_CHECKING:
    from data_gen.static_mesh import StaticMesh
    from prtnet.canvas import Canvas
    from prtnet.console import Console, Report
    from prtnet.lobe_field import LobeField
    from prtnet.scene import Scene
    from prtnet.transfer import Patch, Surface, TransferField
    from runtime.camera import Camera
    from runtime.reel import Frame
    from runtime.worn import Worn

__all__ = [
    "BUILT_IN",
    "FieldOptions",
    "fitted_to",
    "make_field_picture",
    "read_field",
    "worn_by",
]

BUILT_IN = ("vase", "plane")
BOUNDS = CAMERA_BOUNDS | {"dering": (0, 1e6), "twist": (-1e6, 1e6), "repeat": (1, MOST_REPEAT),
                          "lobes": (1, MOST_LOBES)}  # fmt: skip


@dataclass(frozen=True)
class FieldOptions:
    """Options of ``prtnet render`` of a field."""

    field: Positional[Path]  # from prtnet bake: transfer, or lobes
    out: Path  # picture to write, .png, or a movie of what moves, .mp4
    on: str | None = None  # vase or plane, a mesh or a scene; a mesh's field: the scene baked
    repeat: int = 6  # widths of a patch around a vase, across a plane or the longest side of a mesh
    twist: float = 0.0  # degrees about the vertical from bottom to top
    clip: str | None = None  # the animation of a scene (--on); its first when not given
    time: float | None = None  # seconds; the middle of the clip when not given
    lobes: int | None = None  # fit so many lobes to transfer now; drawn as it is when not given
    form: Literal["table", "direct"] = "table"  # lobes: looked up in the light's table, or not
    compare: str | None = None  # truth: traced as posed, of a patch if flat; sh; transfer's file
    light: str = "studio"  # an .hdr or .exr picture of a light, or the name of a preset
    light_turn: float = 0.0  # turn the light about the vertical by so many degrees
    dering: float = 0.0  # take ripples off a small bright light: 0.01 is mild, 0.1 strong
    size: tuple[int, int] = (640, 640)  # of the picture, in pixels
    azimuth: float = 30.0  # of the camera: degrees to the left of the mesh from in front
    elevation: float = 12.0  # of the camera: degrees above the horizon
    zoom: float = 1.0  # how many times closer than what shows everything
    exposure: float = 0.0  # stops brighter
    spin: int | None = None  # so many pictures all around, OUT with a number before its .png
    fps: int = 30  # pictures a second of a movie: of the clip, or of a twist to and fro
    renderer: Literal["gl", "cpu"] | None = None  # OpenGL, of lobes, or NumPy; what there is
    threads: int | None = None  # CPU threads of a truth; all cores when not given

    def __post_init__(self) -> None:
        """Refuse values that cannot work."""
        check_bounds(self, BOUNDS)
        check_side("--size", self.size, MOST_PIXELS)
        check_pictures(self.out, self.spin, self.time)

    @property
    def playing(self) -> bool:
        """Whether time goes on from picture to picture."""
        return self.out.suffix.lower() == ".mp4" and self.spin is None

    def inputs(self) -> list[Path]:
        """The files that are read."""
        named = [Path(text) for text in (self.on, self.compare, self.light) if text]
        return [self.field, *(path for path in named if path.is_file())]


def check_options(
    options: FieldOptions, named: Mapping[str, str], field: LobeField | TransferField
) -> None:
    """Refuse options that would do nothing.

    Args:
        options: all of them.
        named: those that are given, as ``prtnet.cli_arguments.named_options`` tells.
        field: what is drawn, before lobes are fitted to it.

    Raises:
        PrtnetError: one does nothing for this field, or without another option.
    """
    from prtnet.lobe_field import LobeField
    from prtnet.transfer import Patch

    fitted = isinstance(field, LobeField)
    still = options.on is None or (options.on in BUILT_IN and not Path(options.on).is_file())
    whys = {}
    if not isinstance(field.layout, Patch):
        whys["repeat"] = "is of patches, and this field is a mesh's; leave it out"
    if still:
        whys |= dict.fromkeys(("clip", "time"), "is of a scene that moves; name it with --on")
    if fitted:
        whys["lobes"] = "are fitted already; leave it out, or name the transfer they were fitted to"
    elif options.lobes is None:
        whys["form"] = "is of lobes; add --lobes, or leave it out"
    if options.out.suffix.lower() != ".mp4":
        whys["fps"] = NO_MOVIE
    refuse(named, whys)
    if fitted or options.lobes is not None:
        return
    if options.renderer == "gl":
        raise PrtnetError("--renderer", "gl draws lobes; add --lobes, or leave it out")
    if options.compare == "sh":
        raise PrtnetError("--compare", "sh is what is drawn already; add --lobes to compare them")


def make_field_picture(
    options: FieldOptions, named: Mapping[str, str], threads: int, console: Console
) -> dict[str, Any]:
    """Write the picture; facts about it.

    Args:
        options: what is wanted.
        named: those of them that are given; see ``check_options``.
        threads: of the CPU.
        console: to talk to.

    Raises:
        PrtnetError: field and mesh do not belong together, an option does nothing, there is no such
            clip, time or light, or the file cannot be written.
    """
    from prtnet.lobe_field import LobeField
    from runtime.draw import usable
    from runtime.field_shot import FieldShot, opened_field
    from runtime.picture import auto_exposure, comparison, develop
    from runtime.reel import opened_reel, saved_frames

    field, raw = drawn_field(options, named, console)
    worn = worn_by(options.on, options.repeat, field.layout)
    frames, posed = staged_field(options, worn)
    light = environment(options.light).turned(options.light_turn)
    harmonics = light.harmonics(field.order, options.dering)
    camera = camera_of(options, worn, posed(frames[0]))
    lobed = isinstance(field, LobeField)
    renderer = options.renderer or (usable(console.message) if lobed else "cpu")
    by_table = lobed and options.form == "table"
    own = f"{field.count} lobes" if isinstance(field, LobeField) else "turned transfer"
    exposure: float | None = None  # one for all pictures
    errors: list[dict[str, float]] = []
    beside: Canvas | None = None
    with contextlib.ExitStack() as held:
        draw = held.enter_context(opened_field(field, renderer, by_table))
        report = held.enter_context(console.progress())
        write = held.enter_context(opened_reel(options.out, options.fps))
        for number, frame in enumerate(frames):
            if len(frames) > 1:
                report("pictures", number, len(frames))
            canvas = posed(frame)
            if canvas is not beside:  # a truth is traced once for what stands still
                beside = canvas
                told = compared_with(options, field, raw, canvas, threads, report)
            shot = FieldShot(canvas, harmonics, camera.around(frame.turn), options.size)
            seen = shot.drawn_by(draw, by_table)
            truth = None if told is None else shot.draw(told[0])
            if exposure is None:
                exposure = auto_exposure(seen if truth is None else truth)
            gain = exposure * 2.0**options.exposure
            if told is None or truth is None:
                write(frame, develop(seen, gain))
                continue
            sheet, error = comparison(seen, truth, (own, told[1]), gain)
            errors.append(error)
            write(frame, sheet)
    facts = {"out": saved_frames(frames, options.out), **field.facts(), "size": options.size,
             "pictures": len(frames)}  # fmt: skip
    if errors:
        facts["error_in_per_cent_of_white"] = errors if len(frames) > 1 else errors[0]
    return facts


def drawn_field(
    options: FieldOptions, named: Mapping[str, str], console: Console
) -> tuple[LobeField | TransferField, TransferField | None]:
    """What is drawn, and the transfer it was fitted to now, or is.

    Raises:
        PrtnetError: the file is none, or an option does nothing for it.
    """
    from prtnet.lobe_field import LobeField
    from prtnet.lobe_fit import lobe_field

    field = read_field(options.field)
    check_options(options, named, field)
    if isinstance(field, LobeField):
        return field, None
    if options.lobes is None:
        return field, field
    with console.progress() as report:
        return lobe_field(field, options.lobes, False, report), field


def staged_field(
    options: FieldOptions, worn: Worn
) -> tuple[list[Frame], Callable[[Frame], Canvas]]:
    """The pictures to make, and what poses the canvas for one.

    Raises:
        PrtnetError: there is no such clip or time, or nothing moves.
    """
    from runtime.reel import reel
    from runtime.worn import swung

    if worn.scene is None and (options.clip is not None or options.time is not None):
        raise PrtnetError(worn.name, "does not move; leave out --clip and --time")
    clip, twist = worn.clip(options.clip), math.radians(options.twist)
    start, end = (0.0, 0.0) if clip is None else (clip.start, clip.end)
    time = (start + end) / 2 if options.time is None else options.time
    times = worn.times(clip, bool(twist), options.fps) if options.playing else ()

    @functools.lru_cache(1)
    def at(time: float) -> Canvas:
        return worn.at(clip, time, swung(twist, time - start) if options.playing else twist)

    return reel(options.out, options.spin, time, times), lambda frame: at(frame.time)


def camera_of(options: FieldOptions, worn: Worn, canvas: Canvas) -> Camera:
    """Sees the pose, or in a movie all that it comes to, from where it is wanted."""
    from runtime.camera import Camera

    seen = canvas.positions
    if options.playing:
        seen = worn.extent(worn.clip(options.clip), math.radians(options.twist))
    angles = np.radians([options.azimuth, options.elevation]).tolist()
    aspect = options.size[0] / options.size[1]
    return Camera.framing(seen, aspect, *angles).nearer(options.zoom)


def read_field(path: Path) -> LobeField | TransferField:
    """A field of either kind.

    Raises:
        PrtnetError: it is none.
    """
    from prtnet.lobe_field import LobeField
    from prtnet.transfer import TransferField

    return (LobeField if header_key(path) == LOBES else TransferField).load(path)


def compared_with(
    options: FieldOptions,
    field: LobeField | TransferField,
    raw: TransferField | None,
    canvas: Canvas,
    threads: int,
    report: Report,
) -> tuple[TransferField, str] | None:
    """Full transfer to compare with, and what it is; None for nothing.

    Raises:
        PrtnetError: there is none, or it is of something else.
    """
    from prtnet.cli_field_truth import traced_anew

    if options.compare is None:
        return None
    if options.compare == "truth":
        return traced_anew(field, canvas, threads, report)
    if options.compare == "sh":
        if raw is None:
            raise PrtnetError("--compare", "sh needs transfer; name the field lobes were fitted to")
        return raw, "turned harmonics"
    return fitted_to(field, options.compare), "turned harmonics"


def fitted_to(field: LobeField | TransferField, path: str) -> TransferField:
    """The transfer of a file, that these lobes were fitted to.

    Raises:
        PrtnetError: it is of something else.
    """
    from prtnet.transfer import TransferField

    other = TransferField.load(path)
    same = other.order == field.order and other.rows == field.rows and len(other) == len(field)
    if not same or type(other.layout) is not type(field.layout):
        raise PrtnetError(path, "is of something else; name what lobes fit")
    return other


def worn_by(on: str | None, repeat: int, layout: Patch | Surface) -> Worn:
    """What a field is shown on.

    Args:
        on: as ``--on``.
        repeat: as ``--repeat``.
        layout: of the field.

    Raises:
        PrtnetError: it does not belong to the field, or cannot be read.
    """
    from prtnet.canvas import Canvas, boxed, plane, vase
    from prtnet.transfer import Patch
    from runtime.worn import Worn

    built_in = on in BUILT_IN and not Path(str(on)).is_file()
    if not isinstance(layout, Patch):
        canvas = Canvas(layout.positions, layout.tangents, layout.normals, layout.faces)
        if on is None:
            return Worn("field", canvas)
        if built_in:
            raise PrtnetError("--on", f"{on} is for patches; a mesh's field is on its own mesh")
        mesh, scene = moving_mesh(Path(on))
        if not np.array_equal(mesh.positions, layout.positions):
            raise PrtnetError(on, "is not what the field was baked of; name that, or bake anew")
        return Worn(on, canvas, scene, mesh.vertices)
    shape = layout.size[1] / layout.size[0]
    if on is None or built_in:
        return Worn(on or BUILT_IN[0], (plane if on == "plane" else vase)(repeat, shape))
    mesh, scene = moving_mesh(Path(on))
    width = float(np.ptp(mesh.positions, axis=0).max()) / repeat
    canvas, source = boxed(mesh.positions, mesh.normals, mesh.faces, (width, width * shape))
    return Worn(on, canvas, scene, mesh.vertices[source])


def moving_mesh(path: Path) -> tuple[StaticMesh, Scene | None]:
    """A mesh at rest, and the scene that moves it, if any does.

    Raises:
        PrtnetError: it cannot be read.
    """
    from data_gen.readers import READERS, read_scene
    from data_gen.static_mesh import read_mesh
    from prtnet.cli_arguments import input_file

    mesh = read_mesh(input_file(path))
    scene = read_scene(path) if path.suffix.lower() in READERS else None
    return mesh, scene if scene is not None and scene.clips else None
