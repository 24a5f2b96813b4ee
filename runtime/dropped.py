"""Models and scenes that fall on the viewer.

What cannot be shown is told in the window, and what was there stays.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from prtnet.modelled_scene import OtherMeshError

if TYPE_CHECKING:
    from runtime.base_viewer import Steps
    from runtime.cast import Cast
    from runtime.viewer import Viewer

__all__ = ["recast"]


def recast(viewer: Viewer, found: Mapping[str, Path]) -> None:
    """Show another model, scene, or both, once they are opened.

    They may fall together or one after the other: one that does not go with what is shown is
    remembered until the other comes.
    """
    desk = viewer.desk
    files = {"model": desk.model, "scene": desk.scene, **viewer.waiting_files, **found}

    opened = partial(desk.open_files, files["model"], files["scene"])
    view, studio = dataclasses.replace(viewer.view), viewer.show.studio

    def make() -> Cast:
        cast = opened()
        cast.ready(view.clip)
        studio.prepare(view, cast.actor.model.order)
        return cast

    def take(cast: Cast) -> Steps[str]:
        yield from viewer.take(cast)
        desk.model, desk.scene = files["model"], files["scene"]
        viewer.waiting_files = {}
        return f"{desk.model.name} on {desk.scene.name}"

    def fail(error: Exception) -> None:
        viewer.complain(error)
        if isinstance(error, OtherMeshError):
            viewer.waiting_files = found
            if len(found) == 1:
                viewer.message += f" (or drop its {'scene' if 'model' in found else 'model'})"

    names = " and ".join(path.name for path in found.values())
    viewer.open(names, make, take, fail)
