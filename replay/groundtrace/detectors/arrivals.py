"""What arrival pickers share: from a decision function to candidates with refined onsets.

A picker gives the level of its decision function, reduced to cells of about 1 ms; the ratio of a
cell to the noise level some time before it is the candidates' first column. Candidates are the
local maxima of that ratio; their onset is refined by AIC on the signal as recorded.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, Protocol

import numpy as np

from groundtrace_codecs.events import Quantity

from ..detector import Curve, Measured
from ..gates import Candidates
from ..lanes import LANES
from .cells import CELL_S, LocalMaxima, NoiseLevel, NoiseRatio, Rises
from .frames import FrameTrace
from .lane_history import LaneHistory, SampleClock
from .onset import with_onsets

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from .cells import Cells

COLUMNS = (Quantity("ratio", "1"), Quantity("uncertainty", "s"))
NOTHING = Candidates.empty(len(COLUMNS))


@dataclass(frozen=True, slots=True)
class ArrivalSettings:
    """How candidates are found and refined; all times in seconds.

    Attributes
    ----------
    gap_s, warm_up_s
        See :class:`~groundtrace.detectors.cells.NoiseRatio`.
    floor
        Smallest ratio kept as a candidate.
    separation_s
        A candidate is the largest ratio within this distance.
    anchor
        Where the onset is looked for: at the begin of the ``rise`` of the ratio over the floor,
        or at the ``peak`` of what the decision function averages.
    back_s
        The anchor lies at most this long before the maximum of the ratio.
    windows_s
        Pairs (before, after) the anchor: the AIC windows whose onsets are averaged.
    correlation_s
        Correlation time of the signal.
    """

    gap_s: float
    warm_up_s: float
    floor: float
    separation_s: float
    anchor: Literal["rise", "peak"]
    back_s: float
    windows_s: tuple[tuple[float, float], ...]
    correlation_s: float

    @classmethod
    def of(
        cls,
        parameters: ArrivalParameters,
        anchor: Literal["rise", "peak"],
        back_s: float,
        windows_s: tuple[tuple[float, float], ...],
        correlation_s: float,
    ) -> ArrivalSettings:
        """Return the settings of a picker: its parameters, and how it refines onsets."""
        p = parameters
        shared = (p.gap_s, p.warm_up_s, p.floor, p.separation_s)
        return cls(*shared, anchor, back_s, windows_s, correlation_s)


class ArrivalParameters(Protocol):
    """What the parameters of every arrival picker have in common."""

    @property
    def gap_s(self) -> float:
        """Time between noise and signal [s]."""

    @property
    def warm_up_s(self) -> float:
        """Noise needed to trust its level [s]."""

    @property
    def floor(self) -> float:
        """Lowest ratio kept as a candidate."""

    @property
    def separation_s(self) -> float:
        """Least time between candidates [s]."""


class ArrivalTracker:
    """Turns cells of decision functions into candidates, block by block.

    Parameters
    ----------
    rate_hz, channels
        Of the stream.
    settings
        See :class:`ArrivalSettings`.
    noise
        Makes, for cells of a given length [s], the noise level that
        :class:`~groundtrace.detectors.cells.NoiseRatio` takes.
    signals
        How many signals the history has: first that in which onsets are refined, last what the
        decision function averages, where that is another.

    Attributes
    ----------
    clock, history
        Times and signals of the run; the picker adds to them before it tells the cells.
    """

    def __init__(
        self,
        rate_hz: float,
        channels: int,
        settings: ArrivalSettings,
        noise: Callable[[float], NoiseLevel],
        signals: int = 1,
    ) -> None:
        self.settings = settings
        self.rate_hz = rate_hz
        self.clock = SampleClock()
        self.history = LaneHistory(signals, channels)
        self._channels = channels
        self._length = max(1, round(CELL_S * rate_hz))
        cell_s = self._length / rate_hz
        gap = max(1, round(settings.gap_s / cell_s))
        self._ratio = NoiseRatio(noise(cell_s), gap, settings.warm_up_s / cell_s)
        reach = max(1, round(settings.separation_s / cell_s))
        back = round(settings.back_s / cell_s)
        self._maxima = LocalMaxima(channels, reach, settings.floor, back)
        self._trace = FrameTrace(1 / cell_s, channels)
        self._reached: tuple[Cells, NDArray[np.float64]] | None = None
        self._waiting = Rises.none()  # maxima whose AIC windows are open
        self._held = NOTHING
        self._back = round(settings.back_s * rate_hz)
        self._windows = np.rint(np.array(settings.windows_s) * rate_hz).astype(np.intp)
        before, self._after = (int(most) for most in self._windows.max(axis=0))
        self._before = self._back + before

    def take(self, cells: Cells) -> Measured:
        """Take the cells that are complete by now, after the samples were added to the history."""
        if not len(cells):
            self._reached = (cells, cells.level)
            return Measured(NOTHING, self._trace.nothing())
        ratio = self._ratio(cells.level)
        self._reached = (cells, ratio)
        start, stop, step = self._trace.begins(len(cells)).indices(len(cells))
        begins = np.arange(cells.first + start, cells.first + stop, step)
        rows = (ratio, cells.peak, cells.power, cells.high, cells.low)
        frames = self._trace.take(self.clock.at(begins * self._length), *rows)
        return Measured(self._candidates(ratio, final=False), frames)

    def curve(self, level: Callable[[int, int], NDArray[np.float64]]) -> Curve | None:
        """Return the decision function over the samples of the last complete cells.

        Its largest value within a cell is the cell's ratio, which candidates have.

        Parameters
        ----------
        level
            Gives the level of samples ``[start, stop)`` of the run, shape (n, n_channels).
        """
        if self._reached is None:
            return None
        cells, ratio = self._reached
        start = cells.first * self._length
        stop = start + len(cells) * self._length
        scale = np.divide(ratio, cells.level, out=np.zeros_like(ratio), where=cells.level > 0)
        by_cell = level(start, stop).reshape(len(cells), self._length, self._channels)
        value = (by_cell * scale.T[:, np.newaxis]).reshape(stop - start, self._channels)
        return Curve(self.clock.at(np.arange(start, stop)), value)

    def finish(self) -> Measured:
        """End the run: the last cells count although nothing follows them."""
        candidates = self._candidates(np.empty((self._channels, 0)), final=True)
        return Measured(candidates, self._trace.finish())

    def _candidates(self, ratio: NDArray[np.float64], *, final: bool) -> Candidates:
        waiting = self._waiting.and_then(self._maxima.add(ratio, final=final))
        closed = self.history.end - self._after
        # in the order of their cells: those whose windows are open are the last
        ready = int(np.searchsorted((waiting.peak + 1) * self._length, closed, side="right"))
        ready = len(waiting.peak) if final else ready
        self._waiting = waiting.part(slice(ready, None))
        if ready:
            self._held = self._refined(waiting.part(slice(ready)))
        return self._held if final else self._release()

    def _release(self) -> Candidates:
        """Give out what no later candidate can precede, and forget the samples before that."""
        peaks = self._waiting.peak
        next_cell = int(peaks[0]) if len(peaks) else self._maxima.settled
        earliest = next_cell * self._length - self._before - 1
        if earliest <= self.history.first:
            return NOTHING
        horizon_ns = self.clock.time_of(earliest)
        self.history.drop_before(earliest)
        self.clock.forget_before(min(earliest, self._reached_from()))
        count = int(np.searchsorted(self._held.time_ns, horizon_ns, side="left"))
        if not count:
            return NOTHING
        released, self._held = self._held.rows(slice(count)), self._held.rows(slice(count, None))
        return released

    def _reached_from(self) -> int:
        """Return the sample from which the curve can be asked for."""
        return 0 if self._reached is None else self._reached[0].first * self._length

    def _refined(self, rises: Rises) -> Candidates:
        """Return the candidates that are held, and those at the onsets of rises."""
        held = (self._held.time_ns, self._held.channel, self._held.value)
        signal = (self.history.rows(), (self.history.first, self.history.end))
        new = (self._anchors(rises), rises.channel, rises.value)
        correlation = self.settings.correlation_s * self.rate_hz
        clock = (self.clock.table, self.rate_hz)
        return Candidates(*with_onsets(held, signal, new, self._windows, correlation, clock))

    def _anchors(self, rises: Rises) -> NDArray[np.intp]:
        """Return the sample around which each onset is looked for."""
        length, channel = self._length, rises.channel
        if self.settings.anchor == "rise":
            return rises.begin * length
        width = self._back + length
        stop = (rises.peak + 1) * length
        index = stop[:, None] - width + np.arange(width)
        index = np.maximum(index, self.history.first)
        places = (channel[:, None] // LANES, index - self.history.first, channel[:, None] % LANES)
        drive = np.abs(self.history.rows(-1)[places])
        return np.asarray(index[np.arange(len(stop)), drive.argmax(axis=1)])
