"""Rows that stand for several of a kind: their numbers and times, short."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

#: So many spans of numbers are written out.
WRITTEN = 4


def spans(numbers: Sequence[int]) -> str:
    """Return rising numbers as spans, e.g. ``1-7, 13``; of many spans only the first."""
    found: list[tuple[int, int]] = []
    for number in numbers:
        if found and number == found[-1][1] + 1:
            found[-1] = (found[-1][0], number)
        else:
            found.append((number, number))
    texts = [str(a) if a == b else f"{a}-{b}" for a, b in found[:WRITTEN]]
    left = sum(b - a + 1 for a, b in found[WRITTEN:])
    return ", ".join(texts) + (f" and {left} more" if left else "")


def first_to_last(times_s: Sequence[float]) -> str:
    """Return the span of times, or the only one."""
    text = f"{times_s[0]:.3f}"
    return text if len(times_s) == 1 else f"{text}-{times_s[-1]:.3f}"
