"""What tests of windows share."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from tests.runtime.windows import SIZE


@pytest.fixture(scope="session")
def window(display: str) -> Iterator[Any]:
    """One for all: a process has one window."""
    del display
    from runtime.base_viewer import open_window

    found = open_window("test", SIZE)
    yield found
    found.close()
    found.destroy()
