"""Scenes from files, told apart by their names."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from data_gen.gltf import read_gltf
from data_gen.point_cache import read_point_cache
from prtnet.errors import PrtnetError
from prtnet.scene import Scene

__all__ = ["read_scene", "require_clips"]

READERS: dict[str, Callable[[Path], Scene]] = {
    ".glb": read_gltf,
    ".gltf": read_gltf,
    ".npz": read_point_cache,
}


def read_scene(path: str | Path) -> Scene:
    """Read an animated scene: ``.glb``, ``.gltf``, or a point cache ``.npz``.

    A scene may have no clips: see ``require_clips``.

    Raises:
        PrtnetError: the file is missing, damaged, of another kind, or has no triangles.
    """
    path = Path(path)
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise PrtnetError(path, f"is not a scene; give a file that ends in {', '.join(READERS)}")
    return reader(path)


def require_clips(scene: Scene) -> None:
    """Check that a scene is animated.

    Raises:
        PrtnetError: it has no clips.
    """
    if not scene.clips:
        raise PrtnetError(
            scene.path or scene.name, "has no animation; export it with at least one clip"
        )
