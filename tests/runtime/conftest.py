"""What tests of OpenGL and of windows share."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import moderngl
import pytest

from runtime.gl import create_context
from tests.runtime.windows import SIZE


@pytest.fixture(scope="module")
def context() -> Iterator[moderngl.Context]:
    """Without a window."""
    made = create_context()
    with made:
        made.framebuffer([made.texture((1, 1), 4)]).use()  # nothing is drawn without any
        yield made
    made.release()


@pytest.fixture(scope="session")
def window(display: str) -> Iterator[Any]:
    """One for all: a process has one window."""
    del display
    from runtime.base_viewer import open_window

    found = open_window("test", SIZE)
    yield found
    found.close()
    found.destroy()
