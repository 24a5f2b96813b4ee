"""Files that fall on the viewer: models, scenes, lights, measured materials.

What cannot be shown is told in the window, and what was there stays.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from prtnet.errors import PrtnetError
from prtnet.modelled_scene import OtherMeshError

if TYPE_CHECKING:
    from runtime.viewer import Viewer

__all__ = ["take_files"]

KINDS = {
    ".safetensors": "model",
    ".glb": "scene",
    ".gltf": "scene",
    ".npz": "scene",
    ".binary": "brdf",
    ".hdr": "light",
    ".pic": "light",
    ".rgbe": "light",
    ".exr": "light",
}


def take_files(viewer: Viewer, paths: Sequence[str | Path]) -> None:
    """Show what fell on the window.

    A model and its scene may fall together or one after the other: one that does not go with what
    is shown is remembered until the other comes.
    """
    viewer.message = ""
    found: dict[str, Path] = {}
    for path in map(Path, paths):
        kind = KINDS.get(path.suffix.lower())
        if kind is None:
            known = ", ".join(KINDS)
            viewer.complain(PrtnetError(path, f"is none of what can be shown here: {known}"))
        elif kind in ("brdf", "light"):
            viewer.change(kind, str(path))
        else:
            found[kind] = path
    if found:
        recast(viewer, found)


def recast(viewer: Viewer, found: dict[str, Path]) -> None:
    """Show another model, scene, or both."""
    desk = viewer.desk
    files = {"model": desk.model, "scene": desk.scene, **viewer.waiting_files, **found}
    try:
        viewer.take(desk.open_files(files["model"], files["scene"]))
    except OtherMeshError as error:
        viewer.waiting_files = found
        viewer.complain(error)
        if len(found) == 1:
            viewer.message += f" (or drop its {'scene' if 'model' in found else 'model'})"
    except Exception as error:
        viewer.complain(error)
    else:
        desk.model, desk.scene = files["model"], files["scene"]
        viewer.waiting_files = {}
        viewer.message = f"{desk.model.name} on {desk.scene.name}"
