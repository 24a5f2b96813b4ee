"""How many threads are worth starting."""

from __future__ import annotations

import os

__all__ = ["core_count"]


def core_count() -> int:
    """Cores this process may use: in a container or a batch job, fewer than the machine has."""
    if hasattr(os, "sched_getaffinity"):  # not on macOS and Windows
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
