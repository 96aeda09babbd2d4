"""Picks channel by channel, and channels whose picks are all off by nearly the same time."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.labels import SIMULATOR

from ..score.picks import pick_state
from .readings import timed

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.labels import Label

    from .arrivals import BadPick

    Array = NDArray[np.float64]

#: A constant explains the errors of a channel where it gains so much (BIC of a Laplace law, whose
#: scale is the mean absolute error): "very strong", R. E. Kass, A. E. Raftery, Bayes factors,
#: J. Am. Stat. Assoc. 90 (1995), section 3.2; in at least so many picks.
STEADY_GAIN, STEADY_PICKS = 10.0, 6
#: A constant at which no error is left is reckoned with this one [s]: no picker is finer.
LEAST_SCATTER_S = 5e-5


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

    ``clock`` and ``latency`` say that they are late or early by nearly the same time, and why:
    see :class:`Steady`.
    """

    channel: str
    counts: PickCounts
    median_ms: float
    clock: bool
    latency: bool


@dataclass(frozen=True, slots=True)
class Steady:
    """A channel whose picks are late or early by nearly the same time.

    Attributes
    ----------
    cause
        ``latency``, the picker's: true arrivals that were read off the trace share its clock, and
        what all channels have alike is none of one of them. ``clock`` where true arrivals were
        computed and the other channels are not so late.
    offset_s
        By how much they are late (< 0: early), the median [s].
    before_s, after_s
        Mean size of the errors, as they are and without it [s].
    picks
        How many picks.
    gain
        By how much it explains them better than no constant (BIC).
    others_s
        The median of the other channels' [s]; NaN without any.
    """

    cause: str
    offset_s: float
    before_s: float
    after_s: float
    picks: int
    gain: float
    others_s: float

    @property
    def text(self) -> str:
        """The same for people."""
        of = f"{timed(self.offset_s)} in the median of its {self.picks} picks"
        left = f"without that their mean error is {self.after_s * 1e3:.2f} ms, "
        left += f"{self.before_s * 1e3:.2f} ms with it (BIC better by {self.gain:.0f})"
        if self.cause == "clock":
            return f"{of}, the other channels are {timed(self.others_s)}: its clock; {left}"
        return f"{of}: the picker's latency; {left}"


def steady(truth: Sequence[Label], errors_s: Array, tolerance_s: float) -> dict[str, Steady]:
    """Return the channels that are late or early by nearly the same time."""
    names = list(dict.fromkeys(label.channel for label in truth))
    errors = {name: _errors_of(truth, errors_s, name) for name in names}
    medians = {name: float(np.median(own)) for name, own in errors.items() if len(own)}
    found = {}
    for name, own in errors.items():
        if len(own) < STEADY_PICKS or abs(medians[name]) <= tolerance_s:
            continue
        before_s, after_s = (float(np.abs(own - c).mean()) for c in (0.0, medians[name]))
        ratio = before_s / max(after_s, LEAST_SCATTER_S)
        gain = 2 * len(own) * float(np.log(ratio)) - float(np.log(len(own)))
        if gain < STEADY_GAIN:
            continue
        rest = [median for other, median in medians.items() if other != name]
        others_s = float(np.median(rest)) if rest else float("nan")
        computed = all(x.author == SIMULATOR for x in truth if x.channel == name)
        alone = abs(medians[name] - others_s) > tolerance_s
        cause = "clock" if computed and alone else "latency"
        found[name] = Steady(cause, medians[name], before_s, after_s, len(own), gain, others_s)
    return found


def _errors_of(truth: Sequence[Label], errors_s: Array, channel: str) -> Array:
    """Return the errors of the answered arrivals of a channel [s]."""
    own = errors_s[[label.channel == channel for label in truth]]
    answered: Array = own[[pick_state(error) != "missed" for error in own.tolist()]]
    return answered


def by_channel(
    truth: Sequence[Label],
    states: Sequence[str],
    errors_s: Array,
    bad: Sequence[BadPick],
    tolerance_s: float,
) -> tuple[ChannelPicks, ...]:
    """Return the picks of each channel that has true arrivals, by name."""
    constant, found = steady(truth, errors_s, tolerance_s), []
    for name in dict.fromkeys(label.channel for label in truth):
        own = [x for label, x in zip(truth, states, strict=True) if label.channel == name]
        own += [b.state for b in bad if b.channel == name and b.state == "false"]
        errors = _errors_of(truth, errors_s, name)
        found.append(
            ChannelPicks(
                name,
                PickCounts.of(own),
                float(np.median(errors)) * 1e3 if len(errors) else float("nan"),
                name in constant and constant[name].cause == "clock",
                name in constant and constant[name].cause == "latency",
            )
        )
    return tuple(sorted(found, key=lambda item: item.channel))
