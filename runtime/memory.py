"""How much memory things take: on the GPU by what was asked of it, in the process by the system."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import moderngl

__all__ = ["gpu_bytes", "hand_back", "keep_little", "own_bytes", "resident_bytes"]

DEPTH_BYTES = 4  # a sample; drivers round 24 bits up
TRIM_THRESHOLD, MMAP_THRESHOLD, ARENA_MAX = -1, -3, -8  # of mallopt, in malloc.h
KEPT = 1 << 20  # bytes that are free
MAPPED = 4 << 20  # bytes from which an array goes back at once: what is larger leaves larger holes


def gpu_bytes(held: Iterable[Any]) -> int:
    """Bytes of buffers, textures and renderbuffers; other things of OpenGL count as none."""
    return sum(map(bytes_of, held))


def bytes_of(thing: Any) -> int:
    """Bytes of one; what a driver pads them to it does not tell."""
    if isinstance(thing, moderngl.Buffer):
        return int(thing.size)
    if isinstance(thing, moderngl.Texture | moderngl.Renderbuffer):
        texel = DEPTH_BYTES if thing.depth else thing.components * int(thing.dtype[-1])
        return int(thing.width * thing.height * max(1, thing.samples) * texel)
    return 0


def resident_bytes() -> int | None:
    """Memory that this process has in use; None where the system does not say (``/proc``)."""
    return status_bytes("VmRSS")


def own_bytes() -> int | None:
    """Of that what is no file's, in memory or swapped out: files' pages the system takes back."""
    parts = status_bytes("RssAnon"), status_bytes("RssShmem"), status_bytes("VmSwap")
    return None if None in parts else sum(part or 0 for part in parts)


def status_bytes(name: str) -> int | None:
    """A line of what Linux says of this process."""
    try:
        lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
        line = next(line for line in lines if line.startswith(f"{name}:"))
    except (OSError, StopIteration):
        return None
    return 1024 * int(line.split()[1])


def keep_little() -> None:
    """Have glibc keep little of what threads free, from now on; early, before there are many.

    By itself it comes to keep up to 64 MB for every thread that ever made something large, which
    ``malloc_trim`` does not hand back: a window that is open for long, and traces and makes things
    beside its frames, went up and down by hundreds of megabytes. What threads make then lies
    together, not in an arena of each with holes of its own.
    """
    mallopt = of_glibc("mallopt")
    if mallopt is not None:
        mallopt(MMAP_THRESHOLD, MAPPED)
        mallopt(TRIM_THRESHOLD, KEPT)
        mallopt(ARENA_MAX, 1)


def hand_back() -> None:
    """Have glibc hand back what is free between things that are held; takes milliseconds."""
    trim = of_glibc("malloc_trim")
    if trim is not None:
        trim(0)


def of_glibc(name: str) -> Any:
    """A function of the C library; None where it is another."""
    return getattr(ctypes.CDLL(None), name, None) if sys.platform.startswith("linux") else None
