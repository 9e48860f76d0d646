"""What JAX has compiled takes several memory maps a program, of which Linux gives a process some 65,000: one that
diagnoses log after log comes to more and would end with a segmentation fault."""

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
