"""Tops of a worn sensor that end at the very same value: too short to be flat, no chance.

A heel strike is over its sensor's limit for a sample or two. The highest value of a signal comes
once; where it comes again, in tops of their own, chance must explain it. The values next below tell
by how much: if so many steps of the digitiser hold so many of them, the highest step holds another
one so often, and n more by the law of Poisson.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from .finding import Finding, Tally, percent, times
from .full_scales import WORN, clipped_effect, near_scale

if TYPE_CHECKING:
    from collections.abc import Iterator

    from groundtrace_codecs.signals import Channel, Stream

    from .windows import Window

#: Chance that the highest value comes again so often, at most.
CHANCE = 1e-6
#: So many of the highest values are kept, and those count that are so near the highest, as a part
#: of the swing.
KEPT, BAND = 64, 0.01
#: Values nearer to each other are the same but for rounding, as a part of the value.
ROUNDING = 1e-6
#: Finer steps than this part of the swing are not believed.
FINEST = 1e-5
#: Where another value comes in more than this part of as many tops, the signal is coarse or repeats
#: itself.
USUAL = 0.5
#: A value that is kept longer is no top [s].
LONGEST_S = 0.2
#: Limits of worn sensors are the same on both sides but for an offset: a side whose extreme is
#: lower than this part of the other's is at none.
SAME = 0.8


@dataclass(slots=True)
class _Side:
    """The highest values of one side, counted upwards, and the tops that end at each."""

    sign: int
    tops: dict[float, Tally] = field(default_factory=dict)
    last: float = math.nan

    @property
    def extreme(self) -> float:
        return max(self.tops, default=-math.inf)

    def hear(self, window: Window, c: int, longest: float) -> None:
        row = self.sign * window.core[c]
        floor = min(self.tops) if len(self.tops) >= KEPT else -math.inf
        for value in np.unique(row[row >= floor])[-KEPT:].tolist():
            at = np.flatnonzero(row == value)
            runs = np.split(at, np.flatnonzero(np.diff(at) > 1) + 1)
            known = self.tops.setdefault(value, Tally())
            for run in runs:
                if len(run) <= longest and not (run[0] == 0 and self.last == value):
                    first = int(run[0])
                    known.add(window.time_ns(first), window.time_ns(first + len(run)), len(run))
        for value in sorted(self.tops)[:-KEPT]:
            del self.tops[value]
        self.last = float(row[-1])

    def chance(self, swing: float) -> float:
        """Return how likely the highest value comes so often by chance."""
        if len(self.tops) < 2:
            return 1.0
        values = np.array(sorted(self.tops))
        apart = np.diff(values)
        apart = apart[apart > ROUNDING * max(abs(values[0]), abs(values[-1]))]
        again = self.tops[self.extreme].events - 1
        usual = max(tops.events for value, tops in self.tops.items() if value != self.extreme)
        if again < 1 or not len(apart) or usual > USUAL * (again + 1):
            return 1.0
        step = max(float(apart.min()), FINEST * swing)
        reach = min(BAND * swing, float(values[-1] - values[0]))
        near = int((values[:-1] >= values[-1] - reach).sum()) + 1
        often = near * step / reach
        return often**again / math.factorial(min(again, 100)) if often < 1 else 1.0


class Repeats:
    """Looks for highest values that come again and again.

    Parameters
    ----------
    stream
        Its accelerations and angular velocities are looked at.
    """

    def __init__(self, stream: Stream) -> None:
        self.stream = stream
        self._sides = {c: (_Side(1), _Side(-1)) for c in stream.columns_of(WORN)}
        self._longest = max(2.0, LONGEST_S * stream.rate_hz)
        self._heard = 0

    def hear(self, window: Window) -> None:
        """Take the next window."""
        self._heard += len(window)
        for c, sides in self._sides.items():
            if np.isfinite(window.core[c]).all() and len(window):
                for side in sides:
                    side.hear(window, c, self._longest)

    def gap(self) -> None:
        """End the run: what comes next continues nothing."""
        for sides in self._sides.values():
            for side in sides:
                side.last = math.nan

    def findings(self) -> Iterator[Finding]:
        """Yield one finding for each channel that comes to the same highest value by no chance."""
        for c, sides in self._sides.items():
            swing = sum(side.extreme for side in sides)
            if not swing > 0:
                continue
            least = SAME * max(side.extreme for side in sides)
            found = [s for s in sides if s.extreme >= least and s.chance(swing) < CHANCE]
            if found:
                yield self._clipped(self.stream.channels[c], found)

    def _clipped(self, channel: Channel, sides: list[_Side]) -> Finding:
        tops = [side.tops[side.extreme] for side in sides]
        at = " and ".join(f"{s.sign * s.extreme * channel.scale:.4g} {channel.unit}" for s in sides)
        scale = near_scale(channel, max(side.extreme for side in sides) * channel.scale)
        share = sum(t.samples for t in tops) / self._heard
        count = sum(t.events for t in tops)
        return Finding(
            self.stream.topic,
            channel.name,
            "clipped",
            min(t.start_ns for t in tops),
            max(t.end_ns for t in tops),
            count,
            share,
            f"clipped at {at}{scale} {times(count)}, {percent(share)} of the samples",
            *clipped_effect(channel),
        )
