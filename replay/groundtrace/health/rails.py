"""Flat tops at the extreme of a channel: a digitiser at full scale, an amplifier at its rail."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from .finding import Tally

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

#: Flat tops so near to each other are of the same rail, as a part of the channel's range.
SAME = 0.002
#: So many flat tops, or one of so many samples, are no chance.
TOPS, LONG_TOP = 2, 5
#: A channel of fewer steps of its digitiser from end to end rests at its extremes by nature.
LEAST_STEPS = 32
#: A signal that goes beyond in more than this part of its flat tops is not held back there.
BEYOND = 0.1


@dataclass(slots=True)
class _Rail:
    """One side; ``level`` counts upwards on both. ``beyond`` counts windows that go beyond it."""

    level: float = float("-inf")
    extreme: float = float("-inf")
    beyond: int = 0
    tops: Tally = field(default_factory=Tally)
    longest: int = 0

    def reach(self, value: float, near: float) -> None:
        self.extreme = max(self.extreme, value)
        self.beyond += int(value > self.level + near)

    def takes(self, value: float, near: float) -> bool:
        return value >= self.extreme - near or abs(value - self.level) <= near

    def add(self, value: float, near: float, span_ns: tuple[int, int], samples: int) -> None:
        if value > self.level + near:
            self.level, self.beyond, self.longest, self.tops = value, 0, 0, Tally()
        self.tops.add(*span_ns, samples)
        self.longest = max(self.longest, samples)

    @property
    def real(self) -> bool:
        enough = self.tops.events >= TOPS or self.longest >= LONG_TOP
        return enough and self.beyond <= BEYOND * self.tops.events


@dataclass(slots=True)
class Rails:
    """Both sides of a channel."""

    _high: _Rail = field(default_factory=_Rail)
    _low: _Rail = field(default_factory=_Rail)

    def reach(self, highest: float, lowest: float) -> None:
        """Say how far the signal of a window goes."""
        self._high.extreme = max(self._high.extreme, highest)
        self._low.extreme = max(self._low.extreme, -lowest)
        near = SAME * self.span
        self._high.reach(highest, near)
        self._low.reach(-lowest, near)

    @property
    def span(self) -> float:
        """How far it is from the lowest to the highest sample."""
        return self._high.extreme + self._low.extreme

    def near(self, values: NDArray[np.floating]) -> NDArray[np.bool_]:
        """Return which values lie at an extreme, or at a level that may be a rail."""
        near, low, high = SAME * self.span, self._low, self._high
        out: NDArray[np.bool_] = (values >= high.extreme - near) | (-values >= low.extreme - near)
        for level in (high.level, -low.level):
            out |= np.abs(values - level) <= near
        return out

    def take(self, value: float, span_ns: tuple[int, int], samples: int, step: float) -> bool:
        """Take a flat stretch with corners; return whether it is one at an extreme."""
        near = SAME * self.span
        if self.span < LEAST_STEPS * step:
            return False
        for rail, sign in ((self._high, 1), (self._low, -1)):
            if rail.takes(sign * value, near):
                rail.add(sign * value, near, span_ns, samples)
                return True
        return False

    def found(self) -> Iterator[tuple[float, Tally]]:
        """Yield the level and the flat tops of each side that is clipped."""
        for rail, sign in ((self._high, 1), (self._low, -1)):
            if rail.real:
                yield sign * rail.level, rail.tops
