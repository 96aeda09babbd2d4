"""Pieces of a signal or a curve around moments that somebody may ask for later.

A step is announced when a later arrival closes its window, which may take long; the signal around
every arrival is kept until then, and nothing else of what has passed.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

if TYPE_CHECKING:
    from numpy.typing import NDArray

    #: Times, shape (n,) [ns], and values, shape (n, n_columns).
    Piece = tuple[NDArray[np.int64], NDArray[np.float32]]

#: Longer than any picker holds an arrival back [ns].
KEEP_NS = 3 * NS_PER_S
#: Arrivals this close together share one excerpt [ns].
SPREAD_NS = NS_PER_S // 20
#: So many moments wait at most to be asked for.
MOST_MOMENTS = 256


@dataclass(slots=True)
class _Moment:
    start_ns: int
    end_ns: int
    time_ns: int
    pieces: list[Piece] = field(default_factory=list)

    def take(self, piece: Piece) -> None:
        times, values = piece
        first, last = np.searchsorted(times, [self.start_ns, self.end_ns])
        if first < last:
            self.pieces.append((times[first:last].copy(), values[first:last].copy()))


class Excerpts:
    """Keeps what lies around moments.

    Parameters
    ----------
    before_s, after_s
        How much is kept before and after a moment [s].
    """

    def __init__(self, before_s: float, after_s: float) -> None:
        self._before_ns = round(before_s * NS_PER_S)
        self._after_ns = round(after_s * NS_PER_S)
        self._recent: deque[Piece] = deque()
        self._moments: deque[_Moment] = deque(maxlen=MOST_MOMENTS)

    def push(self, times_ns: NDArray[np.int64], values: NDArray[np.floating]) -> None:
        """Take the next samples: times, shape (n,), and values, shape (n, n_columns)."""
        if not len(times_ns):
            return
        piece = (times_ns, values.astype(np.float32))
        self._recent.append(piece)
        while self._recent[0][0][-1] < times_ns[-1] - KEEP_NS:
            self._recent.popleft()
        for moment in self._moments:
            moment.take(piece)

    def expect(self, time_ns: int) -> None:
        """Keep what lies around a moment, those of the last seconds included."""
        if any(0 <= time_ns - moment.time_ns < SPREAD_NS for moment in reversed(self._moments)):
            return
        end_ns = time_ns + self._after_ns + SPREAD_NS
        moment = _Moment(time_ns - self._before_ns, end_ns, time_ns)
        for piece in self._recent:
            moment.take(piece)
        self._moments.append(moment)

    def around(self, time_ns: int) -> Piece | None:
        """Return what was kept around a time, or None; forget what lies before it."""
        known = [m for m in self._moments if 0 <= time_ns - m.time_ns < SPREAD_NS and m.pieces]
        while self._moments and self._moments[0].time_ns < time_ns - SPREAD_NS:
            self._moments.popleft()
        if not known:
            return None
        times = np.concatenate([piece[0] for piece in known[-1].pieces])
        values = np.concatenate([piece[1] for piece in known[-1].pieces])
        first, last = np.searchsorted(times, [time_ns - self._before_ns, time_ns + self._after_ns])
        return times[first:last], values[first:last]
