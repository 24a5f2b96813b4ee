"""The work of ``prtnet render FIELD``: local transfer on its mesh, a vase, or any scene.

Beside ``prtnet.cli``, which it serves, it may import the other packages.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from tyro.conf import Positional

from prtnet.array_file import LOBES, TRANSFER, header_key
from prtnet.environment import environment
from prtnet.errors import PrtnetError
from prtnet.limits import (
    MOST_LOBES,
    MOST_PIXELS,
    MOST_REPEAT,
    MOST_THREADS,
    check_side,
    check_within,
)

if TYPE_CHECKING:
    from data_gen.static_mesh import StaticMesh
    from prtnet.arrays import FloatArray
    from prtnet.canvas import Canvas
    from prtnet.console import Console
    from prtnet.lobe_field import LobeField
    from prtnet.transfer import Patch, Surface, TransferField

__all__ = ["FieldOptions", "make_field_picture", "names_field"]

BUILT_IN = ("vase", "plane")
LEAST = {"light_turn": -1e6, "dering": 0, "twist": -1e6, "azimuth": -1e6, "elevation": -89,
         "zoom": 0.1, "exposure": -20}  # fmt: skip
MOST = {"light_turn": 1e6, "dering": 1e6, "twist": 1e6, "azimuth": 1e6, "elevation": 89,
        "zoom": 100, "exposure": 20}  # fmt: skip


@dataclass(frozen=True)
class FieldOptions:
    """Options of ``prtnet render`` of a field."""

    field: Positional[Path]  # from prtnet bake: transfer, or lobes
    out: Path  # picture to write, .png
    on: str | None = None  # vase or plane, a mesh or a scene; a mesh's field: the scene baked
    repeat: int = 6  # widths of a patch around a vase, across a plane or the longest side of a mesh
    twist: float = 0.0  # degrees about the vertical from bottom to top
    clip: str | None = None  # the animation of a scene (--on); its first when not given
    time: float | None = None  # seconds; the middle of the clip when not given
    lobes: int | None = None  # fit so many lobes to transfer now; drawn as it is when not given
    form: Literal["table", "direct"] = "table"  # lobes: looked up in the light's table, or not
    compare: str | None = None  # truth: trace a mesh as it is posed; sh: transfer; or its file
    light: str = "studio"  # an .hdr or .exr picture of a light, or the name of a preset
    light_turn: float = 0.0  # turn the light about the vertical by so many degrees
    dering: float = 0.0  # take ripples off a small bright light: 0.01 is mild, 0.1 strong
    size: tuple[int, int] = (640, 640)  # of the picture, in pixels
    azimuth: float = 30.0  # of the camera: degrees to the left of the mesh from in front
    elevation: float = 12.0  # of the camera: degrees above the horizon
    zoom: float = 1.0  # how many times closer than what shows everything
    exposure: float = 0.0  # stops brighter
    renderer: Literal["gl", "cpu"] | None = None  # OpenGL, of lobes, or NumPy; what there is
    threads: int | None = None  # CPU threads of a truth; all cores when not given

    def __post_init__(self) -> None:
        """Refuse values that cannot work."""
        for option, least in LEAST.items():
            name = f"--{option.replace('_', '-')}"
            check_within(name, getattr(self, option), least, MOST[option])
        check_within("--repeat", self.repeat, 1, MOST_REPEAT)
        check_within("--lobes", self.lobes, 1, MOST_LOBES)
        check_within("--threads", self.threads, 1, MOST_THREADS)
        check_side("--size", self.size, MOST_PIXELS)
        if self.out.suffix.lower() != ".png":
            raise PrtnetError(self.out, "is no name of a PNG picture; end it in .png")

    def inputs(self) -> list[Path]:
        """The files that are read."""
        named = [Path(text) for text in (self.on, self.compare, self.light) if text]
        return [self.field, *(path for path in named if path.is_file())]


def names_field(argv: Sequence[str]) -> bool:
    """Whether the first file of these arguments that is ours is a field."""
    keys = [header_key(word) for word in argv if word.endswith(".safetensors")]
    return next((key for key in keys if key is not None), None) in (TRANSFER, LOBES)


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
    for name, why in whys.items():
        if name in named:
            raise PrtnetError(named[name], why)
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
    from runtime.camera import Camera
    from runtime.draw import usable
    from runtime.field_shot import FieldShot
    from runtime.picture import auto_exposure, comparison, develop, save_png

    field = read_field(options.field)
    check_options(options, named, field)
    raw = None if isinstance(field, LobeField) else field
    if raw is not None and options.lobes is not None:
        from prtnet.lobe_fit import lobe_field

        with console.progress() as report:
            field = lobe_field(raw, options.lobes, False, report)
    canvas = canvas_of(options, field)
    light = environment(options.light).turned(options.light_turn)
    angles = np.radians([options.azimuth, options.elevation]).tolist()
    camera = Camera.framing(canvas.positions, options.size[0] / options.size[1], *angles)
    camera = camera.nearer(options.zoom)
    shot = FieldShot(canvas, light.harmonics(field.order, options.dering), camera, options.size)
    renderer = options.renderer or (
        usable(console.message) if isinstance(field, LobeField) else "cpu"
    )
    picture = shot.draw(field, renderer, options.form == "table")
    facts: dict[str, Any] = {"out": options.out, **field.facts(), "size": options.size}
    if options.compare is None:
        exposure = auto_exposure(picture) * 2.0**options.exposure
        save_png(options.out, develop(picture, exposure))
        return facts
    other, caption = compared_with(options, field, raw, canvas, threads, console)
    truth = shot.draw(other)
    gain = auto_exposure(truth) * 2.0**options.exposure
    own = f"{field.count} lobes" if isinstance(field, LobeField) else "turned transfer"
    sheet, error = comparison(picture, truth, (own, caption), gain)
    save_png(options.out, sheet)
    return {**facts, "error_in_per_cent_of_white": error}


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
    console: Console,
) -> tuple[TransferField, str]:
    """Full transfer to compare with, and what it is.

    Raises:
        PrtnetError: there is none, or it is of something else.
    """
    from prtnet.transfer import Surface, TransferField

    if options.compare == "truth":
        if not isinstance(field.layout, Surface):
            raise PrtnetError("--compare", "truth is of meshes; of a patch compare with sh")
        return retraced(field, canvas, threads, console), "ray-traced where it is"
    if options.compare == "sh":
        if raw is None:
            raise PrtnetError("--compare", "sh needs transfer; name the field lobes were fitted to")
        return raw, "turned harmonics"
    other = TransferField.load(str(options.compare))
    same = other.order == field.order and other.rows == field.rows and len(other) == len(field)
    if not same or type(other.layout) is not type(field.layout):
        raise PrtnetError(str(options.compare), "is of something else; name what lobes fit")
    return other, "turned harmonics"


def retraced(
    field: LobeField | TransferField, canvas: Canvas, threads: int, console: Console
) -> TransferField:
    """Transfer of the mesh simulated again, as it is posed.

    Raises:
        PrtnetError: it scatters or is glossy.
    """
    from data_gen.bake import BakeConfig, bake_mesh
    from data_gen.static_mesh import StaticMesh

    told = field.metadata
    if field.view is not None or "albedo" not in told:
        raise PrtnetError("--compare", "truth is of matte meshes that do not scatter; leave it out")
    config = BakeConfig(
        order=field.order, rays=int(told["rays"]), bounces=int(told["bounces"]),
        albedo=float(told["albedo"]), threads=threads,
    )  # fmt: skip
    positions, normals, tangents = (
        part.astype(np.float32)
        for part in (canvas.positions, canvas.normals, canvas.frames[..., 0])
    )
    every = np.arange(len(positions))
    mesh = StaticMesh(positions, normals, tangents, canvas.faces, every)
    with console.progress() as report:
        return bake_mesh(mesh, config, None, report)


def canvas_of(options: FieldOptions, field: LobeField | TransferField) -> Canvas:
    """What the field is shown on, posed and twisted.

    Raises:
        PrtnetError: it does not belong to the field, or cannot be read.
    """
    from prtnet.transfer import Patch

    if isinstance(field.layout, Patch):
        canvas = patch_canvas(options, field.layout)
    else:
        canvas = mesh_canvas(options, field.layout)
    return canvas.twisted(math.radians(options.twist)) if options.twist else canvas


def patch_canvas(options: FieldOptions, layout: Patch) -> Canvas:
    """A patch on something."""
    from prtnet.canvas import boxed, plane, vase

    shape = layout.size[1] / layout.size[0]
    on = options.on or BUILT_IN[0]
    if on in BUILT_IN and not Path(on).is_file():
        return (vase if on == "vase" else plane)(options.repeat, shape)
    mesh, positions, normals = posed_mesh(options, Path(on))
    width = float(np.ptp(mesh.positions, axis=0).max()) / options.repeat
    canvas, source = boxed(mesh.positions, mesh.normals, mesh.faces, (width, width * shape))
    return canvas.moved(positions[source], normals[source])


def mesh_canvas(options: FieldOptions, layout: Surface) -> Canvas:
    """A mesh that was baked, where it was or in a pose of its scene."""
    from prtnet.canvas import Canvas

    canvas = Canvas(layout.positions, layout.tangents, layout.normals, layout.faces)
    if options.on is None:
        return canvas
    if options.on in BUILT_IN:
        raise PrtnetError("--on", f"{options.on} is for patches; a mesh's field is on its own mesh")
    mesh, positions, normals = posed_mesh(options, Path(options.on))
    if not np.array_equal(mesh.positions, layout.positions):
        raise PrtnetError(options.on, "is not what the field was baked of; name that, or bake anew")
    return canvas.moved(positions, normals)


def posed_mesh(options: FieldOptions, path: Path) -> tuple[StaticMesh, FloatArray, FloatArray]:
    """A mesh at rest, and positions and normals (V, 3) of its vertices in a pose.

    Raises:
        PrtnetError: it cannot be read, or has no such clip or time.
    """
    from data_gen.readers import READERS, read_scene
    from data_gen.static_mesh import read_mesh
    from prtnet.cli_arguments import input_file

    mesh = read_mesh(input_file(path))
    scene = read_scene(path) if path.suffix.lower() in READERS else None
    if scene is None or not scene.clips:
        if options.clip is not None or options.time is not None:
            raise PrtnetError(path, "does not move; leave out --clip and --time")
        return mesh, mesh.positions, mesh.normals
    clip = scene.clip(options.clip) if options.clip else scene.clips[0]
    time = (clip.start + clip.end) / 2 if options.time is None else options.time
    posed = scene.geometry(scene.poses(clip, np.array([time])))
    return mesh, posed.positions[0, mesh.vertices], posed.normals[0, mesh.vertices]
