"""Picks channel by channel, and channels whose clock is to blame."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np

from ..score.picks import ANSWER_S

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.labels import Label

    from .arrivals import BadPick

    Array = NDArray[np.float64]

#: A channel whose picks are off by nearly the same time has its clock to blame: their scatter is
#: below this part of the offset, in at least so many picks.
STEADY_PART, STEADY_PICKS = 0.25, 6


@dataclass(frozen=True, slots=True)
class PickCounts:
    """How many picks are in each state."""

    right: int
    late: int
    early: int
    missed: int
    false: int

    @classmethod
    def of(cls, states: Iterable[str]) -> PickCounts:
        """Count states."""
        count = Counter(states)
        return cls(*[count[f.name] for f in fields(cls)])


@dataclass(frozen=True, slots=True)
class ChannelPicks:
    """The picks of a channel: how many of each state, and how far off they usually are [ms].

    ``clock`` says that they are late or early by nearly the same time.
    """

    channel: str
    counts: PickCounts
    median_ms: float
    clock: bool


def clocks(truth: Sequence[Label], errors_s: Array, tolerance_s: float) -> dict[str, float]:
    """Return the channels that are late or early by nearly the same time, and that time [s]."""
    found = {}
    for name in dict.fromkeys(label.channel for label in truth):
        errors = _errors_of(truth, errors_s, name)
        if len(errors) < STEADY_PICKS:
            continue
        median = float(np.median(errors))
        scatter = float(np.median(np.abs(errors - median)))
        if abs(median) > tolerance_s and scatter <= STEADY_PART * abs(median):
            found[name] = median
    return found


def _errors_of(truth: Sequence[Label], errors_s: Array, channel: str) -> Array:
    """Return the errors of the answered arrivals of a channel [s]."""
    own = errors_s[[label.channel == channel for label in truth]]
    answered: Array = own[np.abs(own) <= ANSWER_S]
    return answered


def by_channel(
    truth: Sequence[Label],
    states: Sequence[str],
    errors_s: Array,
    bad: Sequence[BadPick],
    tolerance_s: float,
) -> tuple[ChannelPicks, ...]:
    """Return the picks of each channel that has true arrivals, by name."""
    steady, found = clocks(truth, errors_s, tolerance_s), []
    for name in dict.fromkeys(label.channel for label in truth):
        own = [x for label, x in zip(truth, states, strict=True) if label.channel == name]
        own += [b.state for b in bad if b.channel == name and b.state == "false"]
        errors = _errors_of(truth, errors_s, name)
        found.append(
            ChannelPicks(
                name,
                PickCounts.of(own),
                float(np.median(errors)) * 1e3 if len(errors) else float("nan"),
                name in steady,
            )
        )
    return tuple(sorted(found, key=lambda item: item.channel))
