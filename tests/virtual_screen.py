"""A screen that only exists in memory, to open windows on."""

from __future__ import annotations

import os
import shutil
import subprocess

import pytest


def started_screen(size: str) -> tuple[subprocess.Popen[bytes], str]:
    """Xvfb under way, and its name for ``DISPLAY``; fails where there is none but must be.

    Args:
        size: width and height in pixels, as in 640x480.
    """
    program = shutil.which("Xvfb")
    if program is None:
        problem = "Xvfb is not installed; run scripts/system-gl.sh"
        if os.environ.get("PRTNET_REQUIRE_GL") == "1":
            pytest.fail(problem)
        pytest.skip(problem)
    reader, writer = os.pipe()
    options = ["-displayfd", str(writer), "-screen", "0", f"{size}x24", "-nolisten", "tcp"]
    server = subprocess.Popen([program, *options], pass_fds=[writer], stderr=subprocess.DEVNULL)
    os.close(writer)
    with os.fdopen(reader) as told:
        return server, f":{told.readline().strip()}"
