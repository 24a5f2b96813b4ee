"""Memory that is freed and kept."""

from __future__ import annotations

import platform
import subprocess
import sys

import pytest

FREED_BY_THREADS = """
import ctypes, threading
from runtime.memory import hand_back, keep_little, resident_bytes

c = ctypes.CDLL(None)
c.malloc.argtypes, c.malloc.restype = [ctypes.c_size_t], ctypes.c_void_p
c.free.argtypes = [ctypes.c_void_p]
c.memset.argtypes = [ctypes.c_void_p, ctypes.c_int, ctypes.c_size_t]
keep_little()

def make(pinned):
    c.free(c.malloc(30 << 20))  # from now on glibc counts on as much
    held = [c.malloc(1 << 20) for _ in range(40)]
    for place in held:
        c.memset(place, 1, 1 << 20)
    if pinned:
        c.malloc(100)
    while held:
        c.free(held.pop())

for pinned in (False, True):
    before = resident_bytes()
    thread = threading.Thread(target=make, args=(pinned,))
    thread.start()
    thread.join()
    kept = resident_bytes() - before
    hand_back()
    print(kept, resident_bytes() - before)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="is of glibc")
def test_what_threads_free_is_handed_back():
    command = [sys.executable, "-c", FREED_BY_THREADS]
    told = subprocess.run(command, capture_output=True, check=True, text=True).stdout
    (free, handed), (_, handed_between) = (
        [round(int(word) / 1e6) for word in line.split()] for line in told.splitlines()
    )
    assert max(free, handed, handed_between) < 5
