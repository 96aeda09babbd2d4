"""How long a case takes: the clock of all tables."""

from __future__ import annotations

import statistics
import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable


def taken_s(case: Callable[[], object], clock: Callable[[], float] = time.process_time) -> float:
    """Return the time of one run by a clock, by default of the processor [s]."""
    began = clock()
    case()
    return clock() - began


def median_s(case: Callable[[], object], runs: int) -> float:
    """Return the median CPU time of some runs after a first one [s]."""
    case()
    return statistics.median(taken_s(case) for _ in range(runs))
