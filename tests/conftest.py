"""Fixtures and habits of the whole suite."""

from __future__ import annotations

import functools
import os
from collections.abc import Iterator
from pathlib import Path

# Workers share the cores: before NumPy or torch read it, one thread each.
if "PYTEST_XDIST_WORKER" in os.environ:
    os.environ.setdefault("OMP_NUM_THREADS", "1")

import hypothesis
import pytest

from tests.virtual_screen import started_screen

REPOSITORY = Path(__file__).resolve().parent.parent

hypothesis.settings.register_profile("local", deadline=None)
hypothesis.settings.register_profile(
    "ci", deadline=None, derandomize=True, database=None, print_blob=True
)
hypothesis.settings.load_profile("ci" if os.environ.get("CI") else "local")


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Sample scenes kept beside the repository; tests that need them are skipped elsewhere."""
    folder = REPOSITORY.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"the sample scenes are not at {folder}")
    return folder


@pytest.fixture
def torch_threads() -> Iterator[None]:
    """Afterwards torch has as many threads as before."""
    import torch

    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


@pytest.fixture
def three_threads(torch_threads: None) -> Iterator[None]:
    """All libraries have three."""
    import torch
    from threadpoolctl import threadpool_limits

    del torch_threads
    with threadpool_limits(3):
        torch.set_num_threads(3)
        yield


@functools.cache
def gl_problem() -> str | None:
    """Why OpenGL cannot be used here, or None."""
    import moderngl

    try:
        moderngl.create_context(standalone=True, backend="egl", require=330).release()
    except Exception as error:  # whatever the driver's loader throws is the answer
        return f"OpenGL 3.3 through EGL is not available ({error}); run scripts/system-gl.sh"
    return None


@pytest.fixture(scope="session")
def display() -> Iterator[str]:
    """A virtual screen to open windows on."""
    server, name = started_screen("1280x1024")
    before = os.environ.get("DISPLAY")
    os.environ["DISPLAY"] = name
    yield name
    if before is None:
        del os.environ["DISPLAY"]
    else:
        os.environ["DISPLAY"] = before
    server.terminate()
    server.wait()


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Tests marked ``gl`` are skipped without OpenGL, unless PRTNET_REQUIRE_GL=1 asks for it."""
    if item.get_closest_marker("gl") and (problem := gl_problem()):
        if os.environ.get("PRTNET_REQUIRE_GL") == "1":
            pytest.fail(problem)
        pytest.skip(problem)
