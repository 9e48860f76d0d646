"""What a diagnosis leaves in its process, where one log follows another: compiled programs and memory."""

import ctypes
import gc
from pathlib import Path

import jax

SHARE = 0.4
"""Of the memory maps that a process may have, from which compiled programs are dropped. A program takes several, and
Linux gives a process some 65,000; one that needs more ends with a segmentation fault."""

LIMIT = Path("/proc/sys/vm/max_map_count")
MAPS = Path("/proc/self/maps")


def clear() -> None:
    """Before the next log."""
    drop_programs()
    free_memory()


def drop_programs() -> None:
    """Drop all compiled programs if they are many; what is called again is compiled again."""
    try:
        most, now = int(LIMIT.read_text()), MAPS.read_bytes().count(b"\n")
    except OSError:  # no Linux
        return
    if now > SHARE * most:
        jax.clear_caches()


def free_memory() -> None:
    """Free objects that refer to each other, and give back to the system what the C library keeps of freed memory: a
    minute's log leaves 2 GB of both."""
    gc.collect()
    try:
        ctypes.CDLL(None).malloc_trim(0)
    except (AttributeError, OSError):  # not glibc
        return
