"""Threads of the libraries that multiply matrices for numpy: one, unless people say otherwise.

Matrices here are small. Shared between threads a product of them gains nothing, and threads that
wait for the next one keep their cores busy: a replay with places took up to a third more CPU time.
"""

from __future__ import annotations

import os

#: What says how many threads such a library starts for each process.
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def one_thread() -> list[str]:
    """Ask for one thread in libraries loaded from now on, and by processes started from here.

    Returns
    -------
    The names that were set in the environment: those that nobody had set.
    """
    unset = [] if any(name in os.environ for name in THREADS) else list(THREADS)
    os.environ.update(dict.fromkeys(unset, "1"))
    return unset
