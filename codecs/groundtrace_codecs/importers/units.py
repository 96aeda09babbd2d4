"""Stated units that cannot be true.

Every accelerometer measures gravity, every magnetometer the earth's field, and no body turns at a
hundred radians a second. Values that cannot be true in the stated unit but have the right size in
another one carry the wrong unit.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..signals import QUANTITIES, to_si

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from ..signals import SignalBlock, Stream

#: Lengths kept of each vector: enough for a median, whatever the recording's length.
_KEPT = 20_000
#: Fewer lengths than this tell nothing.
_ENOUGH = 20


class Range(NamedTuple):
    """What is measured of a quantity: a percentile of the lengths, and where it can lie [SI]."""

    percentile: float
    low: float
    high: float
    #: Units the number may have been in, most usual first.
    units: tuple[str, ...]


#: Gravity is in the median of any carried accelerometer; the field of the earth is 22 to 67 uT,
#: that of a room's iron up to some hundreds; the fastest turns of a foot are near 30 rad/s; the
#: pressure of the air is that of Everest to that of a deep mine.
RANGES = {
    "acceleration": Range(50, 3.0, 40.0, ("g", "mg", "m/s2", "mm/s2")),
    "angular_velocity": Range(99, 0.0, 100.0, ("deg/s",)),
    "magnetic_field": Range(50, 2e-6, 2e-3, ("uT", "mgauss", "gauss", "nT", "mT")),
    "pressure": Range(50, 3e4, 1.3e5, ("hPa", "kPa", "bar", "Pa")),
}
#: Within these a number is believed to be of the unit suggested [SI].
_LIKELY = {
    "acceleration": (7.0, 13.0),
    "angular_velocity": (0.0, 60.0),
    "magnetic_field": (15e-6, 90e-6),
    "pressure": (3e4, 1.1e5),
}
#: Quantities of which some sensors tell the changes only: an app's acceleration without gravity, a
#: microbarometer's pressure.
_CHANGES = frozenset({"acceleration", "pressure"})


@dataclass(slots=True)
class UnitWatch:
    """Hears the blocks of one stream and says which of its units cannot be true.

    Parameters
    ----------
    stream
        What the columns are.
    """

    stream: Stream
    _lengths: dict[str, list[NDArray[np.float64]]] = field(default_factory=dict)
    _count: dict[str, int] = field(default_factory=dict)
    _every: int = 1

    def update(self, block: SignalBlock) -> None:
        """Take the samples of a block into account, fewer of them the longer it goes on."""
        for quantity, columns in self._vectors().items():
            values = block.samples[:: self._every, columns] * self.stream.scales[columns]
            lengths = np.linalg.norm(values, axis=1)
            parts = self._lengths.setdefault(quantity, [])
            parts.append(lengths[np.isfinite(lengths)])
            self._count[quantity] = self._count.get(quantity, 0) + len(parts[-1])
        if max(self._count.values(), default=0) > 2 * _KEPT:
            self._every *= 2
            for quantity, parts in self._lengths.items():
                self._lengths[quantity] = [np.concatenate(parts)[::2]]
                self._count[quantity] = len(self._lengths[quantity][0])

    def remarks(self) -> tuple[str, ...]:
        """Return one line for each quantity whose unit cannot be true."""
        lines = (self._remark(quantity, parts) for quantity, parts in self._lengths.items())
        return tuple(line for line in lines if line is not None)

    def _vectors(self) -> dict[str, list[int]]:
        """Return the columns of each quantity in SI; a vector counts with all three axes only."""
        vectors: dict[str, list[int]] = {}
        for i, channel in enumerate(self.stream.channels):
            if channel.quantity in RANGES and channel.unit == QUANTITIES[channel.quantity]:
                vectors.setdefault(channel.quantity, []).append(i)
        return {
            quantity: columns
            for quantity, columns in vectors.items()
            if len(columns) == (1 if quantity == "pressure" else 3)
        }

    def _remark(self, quantity: str, parts: Sequence[NDArray[np.float64]]) -> str | None:
        lengths = np.concatenate(parts)
        if len(lengths) < _ENOUGH or not lengths.any():
            return None
        range_ = RANGES[quantity]
        value = float(np.percentile(lengths, range_.percentile))
        if range_.low <= value <= range_.high:
            return None
        si = QUANTITIES[quantity]
        fix = _fix(quantity, value)
        if fix is None and quantity in _CHANGES and value < range_.low:
            return None
        what = "99 % of the lengths are below" if range_.percentile > 50 else "the median length is"
        return (
            f"{self.stream.topic}: {quantity} in {si}: {what} {value:.3g} {si}, "
            f"which cannot be{'' if fix is None else f'; {fix}'}"
        )


def _fix(quantity: str, value: float) -> str | None:
    """Return the unit that makes a value likely, said as what to do, None where none does.

    The value may be a number that was never brought to SI, or one that was brought twice.
    """
    low, high = _LIKELY[quantity]
    si = QUANTITIES[quantity]
    for unit in RANGES[quantity].units:
        factor = to_si(unit)[1]
        if unit != si and low <= value * factor <= high:
            return f"as {unit} it would be {value * factor:.3g} {si}: was {unit} called {si}?"
    for unit in RANGES[quantity].units:
        factor = to_si(unit)[1]
        if unit != si and low <= value / factor <= high:
            was = f"{value / factor:.3g}"
            return f"before {unit} was taken to {si} it was {was}: was {si} called {unit}?"
    return None
