"""The work of ``prtnet view FIELD``: a window that shows local transfer on what moves.

Beside ``prtnet.cli``, which it serves, it may import the other packages.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from prtnet.cli_arguments import pictures_folder
from prtnet.cli_field_truth import traced_anew
from prtnet.cli_render_field import BUILT_IN, fitted_to, read_field, worn_by
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
from prtnet.presets import PRESETS as LIGHTS

if TYPE_CHECKING:
    from prtnet.canvas import Canvas
    from prtnet.transfer import TransferField
    from runtime.field_cast import FieldCast
    from runtime.field_viewer import FieldViewer

__all__ = ["ViewFieldOptions", "opened_field_viewer"]


@dataclass(frozen=True)
class ViewFieldOptions:
    """Options of ``prtnet view`` of a field."""

    field: Positional[Path]  # from prtnet bake: transfer, or lobes
    on: str | None = None  # vase or plane, a mesh or a scene; a mesh's field: the scene baked
    repeat: int = 6  # widths of a patch around a vase, across a plane or the longest side of a mesh
    twist: float = 0.0  # degrees about the vertical from bottom to top, to and fro
    clip: str | None = None  # the animation of a scene (--on) to start with; its first
    lobes: int = 4  # that are fitted to transfer
    compare: str | None = None  # of lobes: the file of the transfer they were fitted to
    light: str = "studio"  # an .hdr or .exr picture of a light, or the name of a preset
    size: tuple[int, int] = (1280, 800)  # of the window, in pixels
    out: Path = Path()  # folder of saved pictures
    threads: int | None = None  # CPU threads of a truth; all cores when not given

    def __post_init__(self) -> None:
        """Refuse values that cannot work."""
        check_within("--repeat", self.repeat, 1, MOST_REPEAT)
        check_within("--twist", self.twist, -1e6, 1e6)
        check_within("--lobes", self.lobes, 1, MOST_LOBES)
        check_within("--threads", self.threads, 1, MOST_THREADS)
        check_side("--size", self.size, MOST_PIXELS)


def opened_field_viewer(
    options: ViewFieldOptions, threads: int, say: Callable[[str], None], visible: bool = True
) -> FieldViewer:
    """The window, ready to run.

    Raises:
        PrtnetError: field and mesh do not belong together, there is no such clip or light, or no
            window can be opened.
    """
    from runtime.base_viewer import in_window
    from runtime.field_show import FieldShow
    from runtime.field_view import FieldView
    from runtime.field_viewer import FieldDesk, FieldViewer
    from runtime.memory import keep_little

    keep_little()
    environments = functools.cache(environment)
    environments(options.light)
    cast = field_cast(options.field, options.on, options.repeat, options.compare, threads)
    if options.clip and cast.worn.scene is None:
        raise PrtnetError("--clip", "is of a scene that moves; name it with --on")
    clip = cast.worn.clip(options.clip)
    pictures_folder(options.out)
    view = FieldView(
        "" if clip is None else clip.name, 0.0 if clip is None else clip.start, options.twist,
        count=options.lobes, light=options.light,
        right="lobes" if cast.transfer is None else "harmonics",
    )  # fmt: skip

    def reopened(field: Path, on: str | None) -> FieldCast:
        compare = options.compare if field == options.field else None
        return field_cast(field, on, options.repeat, compare, threads)

    desk = FieldDesk(list(LIGHTS), options.out, say, BUILT_IN, reopened, options.field, options.on)
    return in_window(
        f"prtnet: {options.field.name}", options.size, visible,
        lambda window: FieldViewer(window, FieldShow(window.ctx, cast, environments), view, desk),
    )  # fmt: skip


def field_cast(
    path: Path, on: str | None, repeat: int, compare: str | None, threads: int
) -> FieldCast:
    """A field on something, ready to be shown.

    Args:
        path: from ``prtnet bake``.
        on: as ``--on``.
        repeat: as ``--repeat``.
        compare: the file of the transfer that lobes were fitted to.
        threads: that trace the truth.

    Raises:
        PrtnetError: a file cannot be used, or they do not belong together.
    """
    from prtnet.console import silent
    from prtnet.lobe_field import LobeField
    from runtime.field_cast import FieldCast

    field = read_field(path)
    worn = worn_by(on, repeat, field.layout)
    lobes = field if isinstance(field, LobeField) else None
    if isinstance(field, LobeField):
        transfer = None if compare is None else fitted_to(field, compare)
    elif compare is not None:
        raise PrtnetError("--compare", f"is of lobes, and {path.name} is transfer; leave it out")
    else:
        transfer = field

    def retrace(canvas: Canvas) -> TransferField:
        return traced_anew(field, canvas, threads, silent)[0]

    traceable = None if worn.rest.places is not None else retrace
    return FieldCast(worn, lobes, transfer, traceable, path.stat().st_size)
