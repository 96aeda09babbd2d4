"""The process: threads of matrix libraries, freed memory, its end; the installed version.

The folder that a user works in may be a stranger's, with recordings and whatever else. Nothing in
it is to be executed or to configure anything, neither here nor in processes that are started.

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
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

#: What keeps Python from looking for modules in the working folder (3.11 and newer).
SAFE_PATH = "PYTHONSAFEPATH"


def leave_working_folder() -> None:
    """Look for no module in the working folder, here and in processes started from here.

    Python itself puts it in front with ``-m`` and ``-c``, and where ``PYTHONPATH`` has an empty
    entry. What is named there, or is installed from there, stays.
    """
    os.environ[SAFE_PATH] = "1"
    named = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    places = [""]
    with suppress(FileNotFoundError):  # a folder that was removed holds no module
        places.append(str(Path.cwd()))
    if not sys.flags.safe_path and sys.path[:1] and sys.path[0] in places:
        del sys.path[0]
    if any(named):
        os.environ["PYTHONPATH"] = os.pathsep.join(name for name in named if name)
        if "" in named and places[-1] not in named and places[-1] in sys.path:
            sys.path.remove(places[-1])
    sys.path[:] = [folder for folder in sys.path if folder]


@contextmanager
def safe_path() -> Iterator[None]:
    """Let processes of Python start without the working folder among the places of modules."""
    before = os.environ.get(SAFE_PATH)
    os.environ[SAFE_PATH] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ[SAFE_PATH]
        else:
            os.environ[SAFE_PATH] = before


#: By what numba and matplotlib configure themselves in the working folder, while they are imported.
_CONFIGURATIONS = (".numba_config.yaml", "matplotlibrc")
_IMPORTING = threading.RLock()


@contextmanager
def unconfigured() -> Iterator[None]:
    """Let what is imported meanwhile find no configuration in the working folder.

    Neither package can be told to look elsewhere first, so that the question whether there is such
    a file is answered here.
    """
    with _IMPORTING:
        exists = os.path.exists
        os.path.exists = lambda path: path not in _CONFIGURATIONS and exists(path)
        try:
            yield
        finally:
            os.path.exists = exists


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


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Keep libraries that are loaded already to one thread meanwhile.

    Where the environment says how many there are, as it does of a command, it stays so.
    """
    if any(name in os.environ for name in THREADS):
        yield
        return
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1, "blas"):
        yield


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
