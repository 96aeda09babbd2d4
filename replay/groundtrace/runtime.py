"""The process: threads of matrix libraries, freed memory, its end; the installed version.

Matrices here are small. Shared between threads a product of them gains nothing, and threads that
wait for the next one keep their cores busy: a replay with locations took up to a third more CPU
time.

Freed memory is kept for the next block instead of given back to the system. Blocks of a recording
come and go, some MiB each. By default glibc gives much of that back at once and asks for it again,
and the system hands out every page anew, filled with zeros: two thousand of them while ten minutes
of an IMU are read, a tenth to a sixth of the time that it takes.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import threading

#: What says how many threads such a library starts for each process.
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def limit_blas_threads() -> list[str]:
    """Ask for one thread in libraries loaded from now on, and by processes started from here.

    Returns
    -------
    The names that were set in the environment: those that nobody had set.
    """
    unset = [] if any(name in os.environ for name in THREADS) else list(THREADS)
    os.environ.update(dict.fromkeys(unset, "1"))
    return unset


#: The most that glibc takes for the larger of the two (its manual, "Malloc Tunable Parameters").
_KEPT_BYTES = 32 << 20
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # M_TRIM_THRESHOLD, M_MMAP_THRESHOLD of malloc.h


def raise_malloc_trim() -> bool:
    """Let this process keep up to 32 MiB that it freed; return whether the C library can."""
    # other C libraries of Linux have no such function
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    return mallopt is not None and all(
        mallopt(name, _KEPT_BYTES) for name in (_MMAP_THRESHOLD, _TRIM_THRESHOLD)
    )


def end_as_interrupted() -> None:
    """Let a request to end, or a terminal that closes, end the process as Ctrl-C does."""
    if threading.current_thread() is threading.main_thread():
        for name in ("SIGTERM", "SIGHUP"):  # Windows has no SIGHUP
            if number := getattr(signal, name, None):
                signal.signal(number, signal.default_int_handler)


def installed_version() -> str:
    """Return the version of the distribution; ``0+unknown`` where none is installed."""
    # a help text needs none, and it takes a tenth of its time to load
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("groundtrace")
    except PackageNotFoundError:  # run from a source tree
        return "0+unknown"
