"""Counters of packets or samples: what was lost, came twice or late, and the times they give.

A counter knows what a clock of the host does not: how many samples lie between two that arrived.
It wraps around at its modulus, and begins again where the device was restarted.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..clocks import robust_line
from ..errors import SchemaError
from ..signals import NS_PER_S
from .counters import unwrapped
from .grid import Timing

if TYPE_CHECKING:
    from numpy.typing import NDArray

#: A sample that comes by no more than this too late was overtaken; more is a counter begun again.
_LATE = 32
#: A jump that a host's clock does not see by as much is a counter begun again, too.
_DISBELIEVED = 64
#: Rates within this part of a whole number of hertz are named by it, to say the drift.
_NOMINAL = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class Counted:
    """Rows by their counter.

    Attributes
    ----------
    rows
        Shape (k,): the rows that are kept, in the order of the counter.
    index
        Shape (k,), int64, ascending: the place of each on the grid, from 0.
    of_row
        Shape (n,), int64: the place of every row of the file.
    lost, gaps, duplicates, late, wraps, resets
        How many samples are missing in how many gaps, came twice, came late; how often the counter
        wrapped around and began again.
    """

    rows: NDArray[np.intp]
    index: NDArray[np.int64]
    of_row: NDArray[np.int64]
    lost: int
    gaps: int
    duplicates: int
    late: int
    wraps: int
    resets: int

    def line(self) -> str:
        """Return in words what the counter tells."""
        said = [
            f"{self.lost} samples lost in {self.gaps} gaps" if self.lost else "no sample lost",
            *(
                f"{count} {what}"
                for count, what in (
                    (self.duplicates, "duplicates dropped"),
                    (self.late, "late ones put in order"),
                    (self.wraps, "wrap-arounds"),
                    (self.resets, "restarts of the counter"),
                )
                if count
            ),
        ]
        return ", ".join(said)


def count(
    values: NDArray[np.float64],
    modulus: int | None,
    times_ns: NDArray[np.int64] | None,
    place: str,
) -> Counted:
    """Return where samples lie on their grid.

    A jump by more than half of the modulus, which the counter alone cannot tell, is resolved by the
    times, where there are some. So is a restart; what was lost then is not known and not counted.

    Parameters
    ----------
    values
        The counter, shape (n,).
    modulus
        What it counts to; None where it does not wrap around.
    times_ns
        Of the host, shape (n,) [ns], or None.
    place
        Named in errors.

    Raises
    ------
    SchemaError
        Where a value is no whole number, or beyond the modulus.
    """
    whole = np.isfinite(values) & (np.rint(values) == values) & (np.abs(values) < 2**53)
    inside = whole if modulus is None else whole & (values >= 0) & (values < modulus)
    if not inside.all():
        wrong = values[int(np.argmin(inside))]
        limit = "" if modulus is None else f" of 0 to {modulus - 1}"
        raise SchemaError(f"{place}: expected a counter with whole numbers{limit}, found {wrong:g}")
    counter = values.astype(np.int64)
    raw = np.diff(counter)
    steps = raw
    if modulus is not None:
        steps = np.diff(unwrapped(counter, modulus, min(_LATE, modulus // 4)))
    expected = _expected(steps, times_ns)
    if modulus is not None and expected is not None:
        steps = steps + modulus * np.rint((expected - steps) / modulus).astype(np.int64)
    restart = _restarts(steps, raw, counter[1:], modulus, expected)
    once = np.ones(len(raw)) if expected is None else np.maximum(1, np.rint(expected))
    steps = np.where(restart, once.astype(np.int64), steps)
    of_row = np.concatenate([[0], np.cumsum(steps)]).astype(np.int64)
    of_row -= of_row.min()
    index, rows = np.unique(of_row, return_index=True)
    holes = np.diff(index) - 1
    turns = 0 if modulus is None else int(((steps - raw) // modulus)[~restart].sum())
    return Counted(
        rows=rows,
        index=index.astype(np.int64),
        of_row=of_row,
        lost=int(holes.sum()),
        gaps=int(np.count_nonzero(holes)),
        duplicates=len(of_row) - len(index),
        late=int(np.count_nonzero(steps < 0)),
        wraps=max(0, turns),
        resets=int(np.count_nonzero(restart)),
    )


def _expected(
    steps: NDArray[np.int64], times_ns: NDArray[np.int64] | None
) -> NDArray[np.float64] | None:
    """Return how many samples the host's clock sees between two rows, None without one."""
    if times_ns is None or not len(steps):
        return None
    elapsed = np.diff(times_ns).astype(np.float64)
    usual = steps == 1
    if not usual.any() or elapsed[usual].sum() <= 0:
        return None
    # the mean: a host that gets packets in bursts gives most of them no time at all
    together = np.clip(elapsed[usual], 0, 20 * float(np.mean(np.maximum(elapsed[usual], 0))))
    return elapsed / max(float(np.mean(together)), 1.0)


def _restarts(
    steps: NDArray[np.int64],
    raw: NDArray[np.int64],
    values: NDArray[np.int64],
    modulus: int | None,
    expected: NDArray[np.float64] | None,
) -> NDArray[np.bool_]:
    """Return at which rows but the first the counter began again, shape (n - 1,)."""
    back = steps < -_LATE
    if expected is not None:
        unseen = np.abs(steps - expected) > np.maximum(_DISBELIEVED, 0.2 * np.abs(expected))
        unseen &= (np.abs(steps) > _LATE) | (raw < -_LATE)
        return back | unseen
    if modulus is not None:
        # from anywhere to the very start, not by way of the end
        back = back | ((values <= 1) & (raw < 0) & (steps > max(_LATE, modulus // 8)))
    return back


def timed(
    counted: Counted, times_ns: NDArray[np.int64] | None, rate_hz: float | None, place: str
) -> tuple[Timing, str]:
    """Return the timing of counted samples, and in words what it rests on.

    With times of the host the robust line of time against counter: the samples' own clock, whose
    jitter the host's is not. Without, the counter over the rate.

    Raises
    ------
    SchemaError
        Where the times do not go on.
    """
    if times_ns is None:
        assert rate_hz is not None  # the map's check saw to it
        return Timing(rate_hz, 0, counted.index, None), f"times are the counter at {rate_hz:g} Hz"
    start_ns = int(times_ns[counted.rows[0]])
    since = (times_ns[counted.rows] - start_ns).astype(np.float64)
    line = robust_line(counted.index.astype(np.float64), since)
    if not line.slope > 0:
        raise SchemaError(f"{place}: expected times that go on with the counter, found others")
    anchor_ns = start_ns + round(float(line.value(np.zeros(1))[0]))
    rate = NS_PER_S / line.slope
    nominal = float(round(rate)) if round(rate) and abs(rate / round(rate) - 1) < _NOMINAL else rate
    residual_ms = (since - line.value(counted.index.astype(np.float64))) / 1e6
    spread = np.percentile(residual_ms, [5, 95])
    text = f"{rate:.6g} Hz by the host's clock"
    if rate != nominal:
        sure = line.slope_sigma / line.slope * 1e6
        text += f", {(rate / nominal - 1) * 1e6:+.1f} +- {sure:.1f} ppm of {nominal:g} Hz"
    text += f"; times of the host scatter by {spread[0]:+.1f} to {spread[1]:+.1f} ms (5 to 95 %)"
    return Timing(rate, anchor_ns, counted.index, None), text


def times_going_on(times_ns: NDArray[np.int64], after_ns: int) -> tuple[NDArray[np.int64], int]:
    """Return times that begin again after ``after_ns`` as times that go on, and how often they do.

    Parameters
    ----------
    times_ns
        Shape (n,) [ns].
    after_ns
        What the clock counts to [ns].
    """
    moved = unwrapped(times_ns, after_ns)
    return moved, int(np.count_nonzero(np.diff((moved - times_ns) // after_ns) > 0))
