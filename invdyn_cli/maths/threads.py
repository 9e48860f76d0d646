"""Threads of NumPy's and SciPy's linear algebra.

A diagnosis decomposes thousands of matrices of some hundred rows. A second thread gains nothing there, and where other
processes take the cores each decomposition waits for it: it then lasts ten times as long.
"""

from functools import partial

from threadpoolctl import threadpool_limits

one_blas_thread = partial(threadpool_limits, limits=1, user_api="blas")
"""The context in which linear algebra runs on one thread; nested or repeated, it leaves the limit that it found."""
