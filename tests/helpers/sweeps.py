"""Cases of a sweep: some are tried every day, all others by ``make sweeps``.

So are examples that Hypothesis draws: a quarter of them every day, others each time.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterable


ALL = "GROUNDTRACE_SWEEPS" in os.environ


def examples(count: int) -> int:
    """Return how many examples are to be drawn of those that a sweep draws."""
    return count if ALL else count // 4


def swept(cases: Iterable[Any], *everyday: Any) -> list[Any]:
    """Return the cases of a parametrised test, those of the sweep marked as such.

    Parameters
    ----------
    cases
        All of them; a tuple is several arguments.
    everyday
        Those that are tried every day.
    """
    cases = list(cases)
    assert everyday
    assert all(case in cases for case in everyday), "expected some of the cases"
    return [
        case
        if case in everyday
        else pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=pytest.mark.sweep)
        for case in cases
    ]
