"""Threads: one for linear algebra, several for what does not depend on each other.

A diagnosis decomposes thousands of matrices of some hundred rows. A second thread gains nothing there, and where other
processes take the cores each decomposition waits for it: it then lasts ten times as long.
"""

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import TypeVar

from threadpoolctl import threadpool_limits

X = TypeVar("X")
Y = TypeVar("Y")

one_blas_thread = partial(threadpool_limits, limits=1, user_api="blas")
"""The context in which linear algebra runs on one thread; nested or repeated, it leaves the limit that it found."""


def takes_one_core() -> bool:
    """Whether this is one of several processes that share the cores, as OMP_NUM_THREADS says."""
    return os.environ.get("OMP_NUM_THREADS") == "1"


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def side_by_side(function: Callable[[X], Y], items: Iterable[X]) -> list[Y]:
    """The function of each item, in their order, computed on all cores that this process may take: for functions that
    filter long signals, which several threads do at a time."""
    with ThreadPoolExecutor(1 if takes_one_core() else cores()) as pool:
        return list(pool.map(function, items))
