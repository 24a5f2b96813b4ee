"""What lives on an OpenGL context and is given back together."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import moderngl

__all__ = ["Holding"]


class Holding:
    """Buffers and textures by name, a mesh of some of them, and whatever else was made.

    Args:
        context: that everything lives in; it must be current.
    """

    def __init__(self, context: moderngl.Context) -> None:
        self.context = context
        self._held: dict[str, Any] = {}
        self._mesh: Any = None
        self._made: list[Any] = []

    def release(self) -> None:
        """Give everything back but the context."""
        self._drop(list(self._held))
        for made in reversed(self._made):
            made.release()
        self._made = []

    @property
    def resources(self) -> list[Any]:
        """Buffers and textures that are held."""
        return list(self._held.values())

    def _keep(self, made: Any) -> Any:
        """Something else to be given back in the end."""
        self._made.append(made)
        return made

    def _drop(self, names: Iterable[str]) -> None:
        """Give back a mesh, and those of the buffers and textures of these names that there are."""
        if self._mesh is not None:
            self._mesh.release()
            self._mesh = None
        for name in names:
            if name in self._held:
                self._held.pop(name).release()
