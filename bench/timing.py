"""How much CPU time a case takes: the clock of most tables."""

from __future__ import annotations

import os
import statistics
import sys
import time
from typing import TYPE_CHECKING

from groundtrace.runtime import limit_blas_threads, raise_malloc_trim

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping


def alone() -> None:
    """Let this process run as the command line does.

    It begins again where libraries of numpy may have started threads.

    The CPU time of a process is that of all its threads, and those wait for work by looking for it
    again and again, on whatever core: a product of matrices was then seen at ten times its time.
    """
    if limit_blas_threads():
        os.execv(sys.executable, sys.orig_argv)
    raise_malloc_trim()


def on_one_core() -> None:
    """Keep this process to one core, where a replay hands nothing to another."""
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:1])


def taken_s(case: Callable[[], object]) -> float:
    """Return the CPU time of one run [s]."""
    began = time.process_time()
    case()
    return time.process_time() - began


def median_s(case: Callable[[], object], runs: int) -> float:
    """Return the median CPU time of some runs after a first one [s]."""
    case()
    return statistics.median(taken_s(case) for _ in range(runs))


def interleaved(cases: Mapping[str, Callable[[], object]], runs: int) -> dict[str, float]:
    """Run the cases in turn, so that a drift of the machine's speed meets all; return medians."""
    times: dict[str, list[float]] = {name: [] for name in cases}
    for case in cases.values():
        case()
    for _ in range(runs):
        for name, case in cases.items():
            times[name].append(taken_s(case))
    return {name: statistics.median(each) for name, each in times.items()}
