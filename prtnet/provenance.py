"""What made a file: versions, and what else may change its bytes on one machine and another."""

from __future__ import annotations

import platform
from importlib.metadata import version
from typing import Any

from prtnet import __version__

__all__ = ["made_with"]


def made_with(*packages: str, threads: int | None = None) -> dict[str, Any]:
    """For a file's metadata: versions by name, and the threads where they change the rounding.

    Args:
        packages: those whose arithmetic or format is in the file, as pip calls them.
        threads: that sums were split over; None where results are the same for any number.

    Raises:
        PackageNotFoundError: a package is not installed.
    """
    versions = {name: version(name) for name in sorted(packages)}
    return {
        "prtnet": __version__,
        "python": platform.python_version(),
        "machine": platform.machine(),
        **versions,
        **({} if threads is None else {"threads": threads}),
    }
