"""Memory that was freed: kept for the next block instead of given back to the system.

Blocks of a recording come and go, some MiB each. By default glibc gives much of that back at once
and asks for it again, and the system hands out every page anew, filled with zeros: two thousand of
them while ten minutes of an IMU are read, a tenth to a sixth of the time that it takes.
"""

from __future__ import annotations

import ctypes
import sys

#: The most that glibc takes for the larger of the two (its manual, "Malloc Tunable Parameters").
_KEPT_BYTES = 32 << 20
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # M_TRIM_THRESHOLD, M_MMAP_THRESHOLD of malloc.h


def keep_freed_memory() -> bool:
    """Let this process keep up to 32 MiB that it freed; return whether the C library can."""
    # other C libraries of Linux have no such function
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    return mallopt is not None and all(
        mallopt(name, _KEPT_BYTES) for name in (_MMAP_THRESHOLD, _TRIM_THRESHOLD)
    )
