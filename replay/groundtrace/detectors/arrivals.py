"""What arrival pickers share: from a decision function to candidates with refined onsets.

A picker gives, sample by sample, the level of its decision function. It is reduced to cells of
about 1 ms; the ratio of a cell to the noise level some time before it is the candidates' first
column. Candidates are the local maxima of that ratio; their onset is refined by AIC on the signal
as recorded.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, Protocol

import numpy as np

from groundtrace_codecs.events import Quantity
from groundtrace_codecs.signals import NS_PER_S

from ..detector import Curve, Measured
from ..gates import Candidates
from .cells import CellReducer, LocalMaxima, NoiseLevel, NoiseRatio, Rise
from .frames import FrameTrace
from .onset import aic_onset

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from .cells import Cells

COLUMNS = (Quantity("ratio", "1"), Quantity("uncertainty", "s"))


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


class _History:
    """The last samples of a run, by their index in the run."""

    def __init__(self, channels: int) -> None:
        self.first = 0
        self.times = np.empty(0, np.int64)
        self.rows = np.empty((2, channels, 0))  # signal as recorded, drive

    @property
    def end(self) -> int:
        return self.first + len(self.times)

    def append(
        self, times: NDArray[np.int64], signal: NDArray[np.float64], drive: NDArray[np.float64]
    ) -> None:
        self.times = np.concatenate([self.times, times])
        self.rows = np.concatenate([self.rows, np.stack([signal, drive])], axis=2)

    def drop_before(self, index: int) -> None:
        cut = max(0, index - self.first)
        self.times, self.rows = self.times[cut:], self.rows[:, :, cut:]
        self.first += cut


class ArrivalTracker:
    """Turns decision functions into candidates, block by block.

    Parameters
    ----------
    rate_hz, channels
        Of the stream.
    settings
        See :class:`ArrivalSettings`.
    noise
        Makes, for cells of a given length [s], the noise level that
        :class:`~groundtrace.detectors.cells.NoiseRatio` takes.
    """

    def __init__(
        self,
        rate_hz: float,
        channels: int,
        settings: ArrivalSettings,
        noise: Callable[[float], NoiseLevel],
    ) -> None:
        self.settings = settings
        self.rate_hz = rate_hz
        self._cells = CellReducer(rate_hz, channels)
        cell_s = self._cells.length / rate_hz
        gap = max(1, round(settings.gap_s / cell_s))
        self._ratio = NoiseRatio(noise(cell_s), gap, settings.warm_up_s / cell_s)
        reach = max(1, round(settings.separation_s / cell_s))
        back = round(settings.back_s / cell_s)
        self._maxima = LocalMaxima(channels, reach, settings.floor, back)
        self._trace = FrameTrace(1 / cell_s, channels)
        self._history = _History(channels)
        self._reached: tuple[Cells, NDArray[np.float64]] | None = None
        self._waiting: list[Rise] = []  # maxima whose AIC windows are open
        self._held = Candidates.empty(len(COLUMNS))
        self._back = round(settings.back_s * rate_hz)
        self._windows = [(round(a * rate_hz), round(b * rate_hz)) for a, b in settings.windows_s]
        self._before = self._back + max(a for a, _ in self._windows)
        self._after = max(b for _, b in self._windows)

    def add(
        self,
        times: NDArray[np.int64],
        recorded: NDArray[np.float64],
        signal: NDArray[np.float64],
        drive: NDArray[np.float64],
        level: NDArray[np.float64],
    ) -> Measured:
        """Take samples: times (n,), the others (n_channels, n).

        ``recorded`` is the signal as recorded, ``signal`` that in which onsets are refined,
        ``drive`` what the decision function averages, ``level`` the decision function.
        """
        self._history.append(times, signal, drive)
        cells = self._cells.add(times, recorded, drive, level)
        ratio = self._ratio(cells.level)
        self._reached = (cells, ratio)
        frames = self._trace.add(
            cells.time_ns, ratio, cells.peak, cells.power, cells.high, cells.low
        )
        return Measured(self._candidates(ratio, final=False), frames)

    def curve(self) -> Curve | None:
        """Return the decision function over the samples of the last complete cells.

        Its largest value within a cell is the cell's ratio, which candidates have.
        """
        if self._reached is None:
            return None
        cells, ratio = self._reached
        scale = np.divide(ratio, cells.level, out=np.zeros_like(ratio), where=cells.level > 0)
        value = cells.samples * scale[:, :, None]
        return Curve(cells.sample_ns, value.reshape(len(value), -1).T)

    def finish(self) -> Measured:
        """End the run: the last cells count although nothing follows them."""
        nothing = np.empty((self._history.rows.shape[1], 0))
        candidates = self._candidates(nothing, final=True)
        return Measured(candidates, self._trace.finish())

    def _candidates(self, ratio: NDArray[np.float64], *, final: bool) -> Candidates:
        self._waiting += self._maxima.add(ratio, final=final)
        closed = self._history.end - self._after
        length = self._cells.length
        ready = [row for row in self._waiting if final or (row.peak + 1) * length <= closed]
        self._waiting = self._waiting[len(ready) :]
        self._held = Candidates.concatenate([self._held, self._refined(ready)])
        order = np.lexsort((self._held.channel, self._held.time_ns))
        self._held = self._held.rows(order)
        return self._held if final else self._release()

    def _release(self) -> Candidates:
        """Give out what no later candidate can precede, and forget the samples before that."""
        next_cell = self._waiting[0].peak if self._waiting else self._maxima.settled
        earliest = next_cell * self._cells.length - self._before - 1
        if earliest <= self._history.first or not len(self._history.times):
            return Candidates.empty(len(COLUMNS))
        horizon_ns = self._history.times[earliest - self._history.first]
        count = int(np.searchsorted(self._held.time_ns, horizon_ns, side="left"))
        released, self._held = self._held.rows(slice(count)), self._held.rows(slice(count, None))
        self._history.drop_before(earliest)
        return released

    def _refined(self, rows: list[Rise]) -> Candidates:
        """Return candidates at the onsets of rises."""
        if not rows:
            return Candidates.empty(len(COLUMNS))
        channel = np.array([row.channel for row in rows])
        anchor = self._anchors(rows, channel)
        parts = [self._onsets(anchor, channel, before, after) for before, after in self._windows]
        onset = np.mean([p[0] for p in parts], axis=0)
        deviation = np.sqrt(np.mean([p[1] ** 2 for p in parts], axis=0)) / self.rate_hz
        whole = np.floor(onset).astype(np.intp)
        fraction_ns = np.rint((onset - whole) * NS_PER_S / self.rate_hz).astype(np.int64)
        return Candidates(
            self._history.times[whole - self._history.first] + fraction_ns,
            channel.astype(np.int32),
            np.column_stack([[row.value for row in rows], deviation]).astype(np.float32),
        )

    def _anchors(self, rows: list[Rise], channel: NDArray[np.intp]) -> NDArray[np.intp]:
        """Return the sample around which each onset is looked for."""
        length = self._cells.length
        if self.settings.anchor == "rise":
            return np.array([row.begin * length for row in rows])
        width = self._back + length
        stop = np.array([(row.peak + 1) * length for row in rows])
        index = stop[:, None] - width + np.arange(width)
        index = np.maximum(index, self._history.first)
        drive = np.abs(self._history.rows[1][channel[:, None], index - self._history.first])
        return np.asarray(index[np.arange(len(stop)), drive.argmax(axis=1)])

    def _onsets(
        self, anchor: NDArray[np.intp], channel: NDArray[np.intp], before: int, after: int
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return onset index and deviation [samples] by AIC around the anchors.

        A window that reaches over the start or end of the run is shorter, not padded.
        """
        start = np.maximum(anchor - before, self._history.first)
        length = np.minimum(anchor + 1 + after, self._history.end) - start
        onset, deviation = np.empty(len(anchor)), np.empty(len(anchor))
        correlation = self.settings.correlation_s * self.rate_hz
        for n in np.unique(length):
            rows = length == n
            index = start[rows][:, None] + np.arange(n) - self._history.first
            windows = self._history.rows[0][channel[rows][:, None], index]
            found, spread = aic_onset(windows, correlation)
            onset[rows], deviation[rows] = start[rows] + found, spread
        return onset, deviation
