"""The programs that JAX has compiled: kept on the disk between runs, and dropped from memory when they are many.

A program takes several memory maps, of which Linux gives a process some 65,000: a process that diagnoses log after log
needs more and would end with a segmentation fault.
"""

import os
import warnings
from pathlib import Path

import jax

SHARE = 0.4
"""Of the maps that a process may have, from which compiled programs are dropped."""

LIMIT = Path("/proc/sys/vm/max_map_count")
MAPS = Path("/proc/self/maps")


def drop_many() -> None:
    """Drop all compiled programs if they are many; what is called again is compiled again."""
    try:
        most, now = int(LIMIT.read_text()), MAPS.read_bytes().count(b"\n")
    except OSError:  # no Linux
        return
    if now > SHARE * most:
        jax.clear_caches()


def use_compilation_cache() -> None:
    """Keep compiled programs between runs, in $JAX_COMPILATION_CACHE_DIR or the user's cache folder."""
    warnings.filterwarnings("ignore", "Error (reading|writing) persistent compilation cache")  # it only costs time
    if jax.config.values["jax_compilation_cache_dir"] is None:
        home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        jax.config.update("jax_compilation_cache_dir", str(home / "invdyn" / "jax"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.01)  # a command has a hundred small programs
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)
