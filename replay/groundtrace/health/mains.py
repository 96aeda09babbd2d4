"""Hum of the mains, and what its frequency tells of the sampling rate.

Spectra of 2 s are averaged as logarithms: a line that is always there stands out, bursts like
steps do not. A line with harmonics that lies well off 50 and 60 Hz says that the rate is wrong,
for no mains is half a hertz off.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .finding import Finding, percent

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.signals import Stream

    from .windows import Window

    Array = NDArray[np.float64]

MAINS_HZ = (50.0, 60.0)
#: Length of a spectrum [s], and the rate to which a faster signal is averaged [Hz].
SPECTRUM_S, RATE_HZ = 2.0, 1000.0
#: Rates below this do not show 60 Hz, spectra fewer than this no steadiness.
LEAST_RATE_HZ, LEAST_SPECTRA = 150.0, 4
#: Where a fundamental is looked for [Hz]: rates that are a quarter off.
LOW_HZ, HIGH_HZ = 37.5, 75.0
#: The neighbourhood of a line, without the line itself [Hz].
NEAR_HZ, LINE_HZ = 8.0, 1.5
#: A line stands over it by so much [dB], a harmonic by so much; both besides chance: so many
#: standard deviations of a mean of logarithms, each 5.6 dB.
LINE_DB, HARMONIC_DB, SURE, LOG_DB = 10.0, 6.0, 3.0, 5.6
#: Hum below this part of the quiet power does nothing.
MATTERS = 0.02
#: Mains keep their frequency within this [Hz]; so many harmonics make a line one of mains.
KEPT_HZ, HARMONICS = 0.5, 2


@dataclass(frozen=True, slots=True)
class Line:
    """A steady line: frequency [Hz], part of the quiet power, orders of harmonics seen."""

    frequency_hz: float
    share: float
    harmonics: tuple[int, ...]

    @property
    def mains_hz(self) -> float:
        """The mains frequency it is nearest to, by ratio [Hz]."""
        return min(MAINS_HZ, key=lambda f: abs(np.log(self.frequency_hz / f)))


class Hum:
    """Looks for a steady line in each channel.

    Parameters
    ----------
    stream, columns
        The channels that are looked at.
    """

    def __init__(self, stream: Stream, columns: Sequence[int]) -> None:
        self.stream = stream
        self.columns = list(columns) if stream.rate_hz >= LEAST_RATE_HZ else []
        self._every = max(1, int(stream.rate_hz // RATE_HZ))
        self.rate_hz = stream.rate_hz / self._every
        self.length = round(SPECTRUM_S * self.rate_hz)
        self._logs = np.zeros((len(self.columns), self.length // 2 + 1))
        self._count = np.zeros(len(self.columns), np.int64)
        self._span = (0, 0)
        self.gap()

    def gap(self) -> None:
        """Forget the spectrum that was begun."""
        self._raw = np.empty((len(self.columns), 0), np.float32)
        self._slow = np.empty((len(self.columns), 0))

    def hear(self, window: Window) -> None:
        """Take the next window."""
        if not self.columns:
            return
        raw = np.concatenate([self._raw, window.core[self.columns]], axis=1)
        count = raw.shape[1] // self._every
        self._raw = raw[:, count * self._every :]
        folded = raw[:, : count * self._every].reshape(len(self.columns), count, self._every)
        self._slow = np.concatenate([self._slow, folded.mean(axis=2)], axis=1)
        while self._slow.shape[1] >= self.length:
            self._add(self._slow[:, : self.length])
            self._slow = self._slow[:, self.length // 2 :]
        self._span = (self._span[0] or window.start_ns, window.time_ns(len(window)))

    def _add(self, part: Array) -> None:
        swing = (part - part.mean(axis=1, keepdims=True)) * np.hanning(self.length)
        power = np.abs(np.fft.rfft(swing, axis=1)) ** 2
        # a channel that is dead or not finite in this part says nothing
        good = np.isfinite(power).all(axis=1) & (power.sum(axis=1) > 0)
        self._logs[good] += np.log(power[good] + 1e-12 * power[good].max(axis=1, keepdims=True))
        self._count += good

    def line(self, row: int) -> Line | None:
        """Return the strongest steady line of a channel; None where there is none."""
        if self._count[row] < LEAST_SPECTRA:
            return None
        mean = self._logs[row] / self._count[row]
        # half overlap: spectra are worth about three quarters of their number
        chance_db = SURE * LOG_DB / np.sqrt(0.75 * self._count[row])
        low, high = (round(f * SPECTRUM_S) for f in (LOW_HZ, min(HIGH_HZ, 0.45 * self.rate_hz)))
        over = np.array([_over_db(mean, i) for i in range(low, high + 1)])
        best = low + int(np.argmax(over))
        if over.max() < LINE_DB + chance_db:
            return None
        frequency = _peak(mean, best) / SPECTRUM_S
        harmonics = tuple(
            n
            for n in range(2, 8)
            if n * frequency < 0.45 * self.rate_hz
            and _over_db(mean, round(n * frequency * SPECTRUM_S)) >= HARMONIC_DB + chance_db
        )
        return Line(frequency, _share(mean, (1, *harmonics), frequency), harmonics)

    def findings(self) -> Iterator[Finding]:
        """Yield one finding for each channel with hum that matters, or a line of a wrong rate."""
        for row, c in enumerate(self.columns):
            line = self.line(row)
            if line is not None and line.share >= MATTERS:
                text = self._words(line)
                if text is not None:
                    kind, what, effect, remedy = text
                    name, share = self.stream.channels[c].name, min(line.share, 1.0)
                    span = self._span
                    yield Finding(
                        self.stream.topic, name, kind, *span, 1, share, what, effect, remedy
                    )

    def _words(self, line: Line) -> tuple[str, str, str, str] | None:
        f, mains = line.frequency_hz, line.mains_hz
        orders = ", ".join(f"{n * f:.0f}" for n in line.harmonics)
        also = f" with harmonics at {orders} Hz" if orders else ""
        if abs(f - mains) <= KEPT_HZ:
            return (
                "hum",
                f"hum at {f:.1f} Hz{also}, {percent(line.share)} of the power between steps",
                "weak onsets drown in it",
                _filter_advice(line),
            )
        if len(line.harmonics) < HARMONICS:
            return None
        return (
            "rate",
            f"a steady line at {f:.2f} Hz{also}, where mains have {mains:.0f} Hz",
            f"if it is the mains, the rate is {100 * (f / mains - 1):+.1f} % off: times, "
            f"velocities and bands are wrong by as much",
            f"check whether the rate is {self.stream.rate_hz * mains / f:.6g} Hz rather than "
            f"{self.stream.rate_hz:g} Hz",
        )


def _filter_advice(line: Line) -> str:
    """Return the band that keeps it out: a slope of second order takes 24 dB over two octaves."""
    top = max((1, *line.harmonics)) * line.frequency_hz
    low = 10 * np.ceil(4 * top / 10)
    return (
        f"look for its source; where places suffer, a band above it helps: --set "
        f"picks.low_hz={low:.0f} --set arrivals.low_hz={low:.0f}"
    )


def _over_db(mean: Array, i: int) -> float:
    """Return how far a bin of a mean log power is over the median of its neighbourhood [dB]."""
    near, line = round(NEAR_HZ * SPECTRUM_S), round(LINE_HZ * SPECTRUM_S)
    around = np.concatenate([mean[max(2, i - near) : i - line], mean[i + line + 1 : i + near + 1]])
    return float((mean[i] - np.median(around)) * 10 / np.log(10))


def _peak(mean: Array, i: int) -> float:
    """Return the place of a maximum between bins, by a parabola."""
    left, top, right = mean[i - 1 : i + 2]
    bend = left - 2 * top + right
    return i + (0.5 * float((left - right) / bend) if bend < 0 else 0.0)


def _share(mean: Array, orders: Sequence[int], frequency: float) -> float:
    """Return which part of the quiet power lies in a line and its harmonics."""
    power = np.exp(mean - mean.max())
    lines = 0.0
    for n in orders:
        i = round(n * frequency * SPECTRUM_S)
        lines += float(power[i - 2 : i + 3].sum())
    return lines / float(power[2:].sum())
