"""The work of ``prtnet view`` of all-frequency fields: a window with an object in a turning light.

Beside ``prtnet.cli``, which it serves, it may import the other packages.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tyro.conf import Positional

from prtnet.all_frequency_file import load_fields
from prtnet.cli_arguments import pictures_folder
from prtnet.cores import use_threads
from prtnet.environment import environment
from prtnet.limits import MOST_PIXELS, MOST_THREADS, check_side, check_within
from prtnet.presets import PRESETS

if TYPE_CHECKING:
    from runtime.all_frequency_viewer import AllFrequencyViewer

__all__ = ["AllFrequencyViewOptions", "opened_all_frequency_viewer"]


@dataclass(frozen=True)
class AllFrequencyViewOptions:
    """Options of ``prtnet view`` of a field of all-frequency transfer."""

    field: Positional[Path]  # from prtnet bake-all-frequency
    light: str = "studio"  # an .hdr or .exr picture of a light, or the name of a preset
    turning: float = 30.0  # degrees that the light turns in a second
    size: tuple[int, int] = (1280, 800)  # of the window, in pixels
    out: Path = Path()  # folder of saved pictures
    threads: int | None = None  # CPU threads; all cores when not given

    def __post_init__(self) -> None:
        """Refuse values that cannot work."""
        check_within("--turning", self.turning, -3600, 3600)
        check_within("--threads", self.threads, 1, MOST_THREADS)
        check_side("--size", self.size, MOST_PIXELS)


def opened_all_frequency_viewer(
    options: AllFrequencyViewOptions,
    threads: int,
    say: Callable[[str], None],
    visible: bool = True,
) -> AllFrequencyViewer:
    """The window, ready to run.

    Raises:
        PrtnetError: the file is none, there is no such light, or no window can be opened.
    """
    from runtime.all_frequency_sight import AllFrequencySight, AllFrequencyView
    from runtime.all_frequency_viewer import AllFrequencyDesk, AllFrequencyViewer
    from runtime.base_viewer import in_window
    from runtime.memory import keep_little

    use_threads(threads)
    keep_little()
    environments = functools.cache(environment)
    environments(options.light)
    fields = load_fields(options.field)
    pictures_folder(options.out)
    view = AllFrequencyView(light=options.light, turning=options.turning)
    desk = AllFrequencyDesk(list(PRESETS), options.out, say, load_fields)
    size = options.field.stat().st_size

    def shown(window: Any) -> AllFrequencyViewer:
        show = AllFrequencySight(window.ctx, fields, environments, size)
        return AllFrequencyViewer(window, show, view, desk)

    return in_window(f"prtnet: {options.field.name}", options.size, visible, shown)
