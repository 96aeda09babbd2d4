"""Clipped tops without equal samples: amplifiers at a rail, worn sensors at their limit.

A digitiser at full scale repeats one value (:mod:`.signal_faults`). An amplifier's rail differs by
a few percent from top to top and between its two sides, and carries noise; a gyroscope at its limit
is multiplied, shifted and mixed with the other axes by its calibration. What is left of the cut is
the corner. The highest samples of a smooth top are a parabola, whose slope beside n samples is 4 /
n of their spread, whatever the rate and the height. A slope of many times that on both sides is not
the signal's own.

Tops of a worn sensor may be too short to be flat: a heel strike is over the sensor's limit for a
sample or two. They end at the very same value. The highest value of a signal comes once; where it
comes again, in tops of their own, chance must explain it. The values next below give the rate: if
so many steps of the digitiser hold so many of them, the highest step holds another one so often,
and n more by the law of Poisson.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.events import readable
from groundtrace_codecs.signals import SEISMIC_QUANTITIES

from ..dsp.robust import medians
from .held_values import STEP_PART, WORN, clipped_effect, full_scale, near_scale
from .signal_faults import LEAST_STEPS, FaultSpans, Finding, percent, times

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.signals import Channel, Stream

    from .signal_faults import Window

#: The samples of one top spread by no more than this part of the channel's swing. Chosen by
#: judgement: noise on a limit moves its samples by so much (noise of 0.05 % in
#: docs/accuracy/faults.md).
WITHIN = 0.006
#: Tops of one sign are of one limit within this part of half the swing. Chosen by judgement: more
#: than noise moves a limit, less than two limits differ by.
WANDERS = 0.05
#: Slope beside a flat top in those of a parabola (1), and at least this part of the swing a sample,
#: which noise on a slow signal does not reach. Chosen by trial on 250 simulated rooms of 4
#: channels, 150 of them with seeds from 0 and 100 drawn at random: the second of one side has up to
#: 6.2 by chance, those of a rail hundreds. Near the full scale of a worn sensor, which few signals
#: come to, less is enough: 3.7 to 34 in llio-pyshoe's gyroscopes of 500 deg/s, below 3 twice on one
#: side in all else. bench/corrupted_inputs.py reports other rooms and recordings.
CORNER, STEEP = 10.0, 0.015
CORNER_NEAR_SCALE, STEEP_NEAR_SCALE = 3.0, 0.01
#: Of seismic channels, which are sampled far faster than they swing, a smaller slope is enough
#: where the corner is sharper and two tops of one side are within :data:`WITHIN` of each other.
#: Chosen by trial on both lines of refrapy-seg2, cut off at 0.3 to 0.7 of their peaks, and on 160
#: simulated rooms, where a corner of 10 calls 2 of 640 channels clipped;
#: bench/corrupted_inputs.py reports other rooms.
CORNER_SEISMIC, STEEP_SEISMIC = 20.0, 0.002
#: Samples of a flat top, how many of them, and which part of the tops that come so high are flat.
#: Chosen by judgement: two equal samples are rounding, one flat top is chance, and a rail stops at
#: least a tenth of what comes so high.
SHORTEST, TOPS, PART = 3, 2, 0.1
#: Limits of worn sensors are the same on both sides but for an offset: tops lower than this part of
#: the largest value of either sign are none. Chosen by judgement: what is lower is a top of the
#: signal and not its limit, whatever the offset.
SAME = 0.8
#: So many tops of one side are kept. Chosen by judgement: it bounds memory; far more than a limit
#: needs to be told.
MOST = 2048


@dataclass(frozen=True, slots=True)
class _Top:
    """The highest samples of one excursion: how high, how many, how flat, how steep beside."""

    level: float
    samples: int
    spread: float
    slope: float
    start_ns: int
    end_ns: int


@dataclass(slots=True)
class _Side:
    """Tops of one sign; levels count upwards on both sides."""

    sign: int
    extreme: float = -math.inf
    tops: list[_Top] = field(default_factory=list)

    def near(self, swing: float) -> float:
        """Return from where on tops count."""
        return self.extreme - WANDERS * swing / 2

    def discard(self, swing: float) -> None:
        """Drop what is too low to count any more, and of too many every second one."""
        if len(self.tops) > MOST:
            near = self.near(swing)
            self.tops = [top for top in self.tops if top.level >= near]
            if len(self.tops) > MOST:
                self.tops = self.tops[::2]

    def flat(self, swing: float, step: float, *, near_scale: bool, seismic: bool) -> list[_Top]:
        """Return the tops that are cut off, if they are of a limit.

        Parameters
        ----------
        swing
            From the lowest to the highest sample.
        step
            Nearly the smallest change from sample to sample.
        near_scale
            Whether a full scale is near, so that less is enough.
        seismic
            Whether two tops must share a level; a smaller slope is enough then.
        """
        corner, steep = CORNER, STEEP
        if seismic:
            corner, steep = CORNER_SEISMIC, STEEP_SEISMIC
        elif near_scale:
            corner, steep = CORNER_NEAR_SCALE, STEEP_NEAR_SCALE
        high = [top for top in self.tops if top.level >= self.near(swing)]
        flat = [
            top
            for top in high
            if top.samples >= SHORTEST
            and top.slope >= steep * swing
            and top.slope * top.samples >= corner * 4 * max(top.spread, step)
        ]
        levels = np.sort([top.level for top in flat])
        if seismic and not (np.diff(levels) <= WITHIN * swing).any():
            return []
        return flat if len(flat) >= max(TOPS, PART * len(high)) else []


class Limits:
    """Looks for tops that are cut off.

    Parameters
    ----------
    stream
        Its channels.
    quantities
        Those that are looked at.
    """

    def __init__(self, stream: Stream, quantities: Collection[str] = WORN) -> None:
        self.stream = stream
        columns = stream.columns_of(set(quantities))
        self._sides = {c: (_Side(1), _Side(-1)) for c in columns}
        self._steps = dict.fromkeys(columns, math.inf)
        self._sample_count = 0

    @staticmethod
    def fits(stream: Stream) -> bool:
        """Return whether a stream is one of a worn sensor."""
        return bool(stream.columns_of(WORN))

    def update(self, window: Window) -> None:
        """Take the next window."""
        self._sample_count += len(window)
        for c, sides in self._sides.items():
            core = window.core[c]
            if not np.isfinite(core).any():
                continue
            jumps = np.abs(np.diff(core))
            jumps = jumps[jumps > 0]
            if len(jumps):
                rank = int(STEP_PART * len(jumps))
                self._steps[c] = min(self._steps[c], float(np.partition(jumps, rank)[rank]))
            sides[0].extreme = max(sides[0].extreme, float(np.nanmax(core)))
            sides[1].extreme = max(sides[1].extreme, -float(np.nanmin(core)))
            swing = sides[0].extreme + sides[1].extreme
            for side in sides:
                side.tops.extend(_tops(window, c, side, swing))
                side.discard(swing)

    def gap(self) -> None:
        """Nothing crosses windows."""

    def findings(self) -> Iterator[Finding]:
        """Yield one finding for each channel that is clipped."""
        for c, sides in self._sides.items():
            channel = self.stream.channels[c]
            swing = sides[0].extreme + sides[1].extreme
            step = self._steps[c]
            if not math.isfinite(step) or swing < LEAST_STEPS * step:
                continue
            least = SAME * max(side.extreme for side in sides)
            worn = channel.quantity not in SEISMIC_QUANTITIES
            flat_sides = []
            for side in sides:
                near = full_scale(channel, side.extreme * channel.scale)
                flat = side.flat(swing, step, near_scale=bool(near), seismic=not worn)
                if flat and side.extreme > 0 and (side.extreme >= least or not worn):
                    flat_sides.append((side.sign, flat))
            if flat_sides:
                yield _clipped(self.stream, channel, flat_sides, self._sample_count)


def _tops(window: Window, c: int, side: _Side, swing: float) -> Iterator[_Top]:
    """Yield the tops of a window that come near to the extreme."""
    if swing <= 0:
        return
    row = window.values[c] * side.sign
    above = np.flatnonzero(row > side.near(swing))
    if not len(above):
        return
    for part in np.split(above, np.flatnonzero(np.diff(above) > 1) + 1):
        at = int(part[0]) + int(np.argmax(row[part[0] : part[-1] + 1]))
        if window.left <= at < window.left + len(window):
            yield _grown(window, row, at, WITHIN * swing)


def _grown(window: Window, row: NDArray[np.floating], at: int, within: float) -> _Top:
    """Return the flattest run of samples around the highest one."""
    first = last = at
    highest = float(row[at])
    best, sharpest = _Top(highest, 1, 0.0, 0.0, window.time_ns(at - window.left), 0), -1.0
    while True:
        if last - first + 1 >= SHORTEST and first > 0 and last + 1 < len(row):
            slope = min(float(row[first] - row[first - 1]), float(row[last] - row[last + 1]))
            spread = highest - float(row[first : last + 1].min())
            count = last - first + 1
            corner = slope * count / max(4 * spread, 1e-6 * within)
            if corner > sharpest:
                start = window.time_ns(first - window.left)
                best, sharpest = _Top(highest, count, spread, slope, start, 0), corner
        before = float(row[first - 1]) if first else -math.inf
        after = float(row[last + 1]) if last + 1 < len(row) else -math.inf
        if not max(before, after) >= highest - within:
            break
        first, last = (first - 1, last) if before >= after else (first, last + 1)
    end_ns = best.start_ns + round(best.samples * window.period_ns)
    return _Top(best.level, best.samples, best.spread, best.slope, best.start_ns, end_ns)


def _clipped(
    stream: Stream,
    channel: Channel,
    flat_sides: Sequence[tuple[int, list[_Top]]],
    total_samples: int,
) -> Finding:
    tops = [top for _, flat in flat_sides for top in flat]
    samples = sum(top.samples for top in tops)
    at = " and ".join(
        f"{readable(sign * _middle(flat) * channel.scale)} {channel.unit}"
        for sign, flat in flat_sides
    )
    first = min(tops, key=lambda top: top.start_ns)
    part = percent(samples / total_samples)
    scale = near_scale(channel, max(_middle(flat) for _, flat in flat_sides) * channel.scale)
    return Finding(
        stream.topic,
        channel.name,
        "clipped",
        first.start_ns,
        max(top.end_ns for top in tops),
        len(tops),
        samples / total_samples,
        f"clipped at about {at}{scale} {times(len(tops))}, {part} of the samples",
        *clipped_effect(channel),
    )


def _middle(flat: Sequence[_Top]) -> float:
    return float(medians(np.array([top.level for top in flat])))


#: Chance that the highest value comes again so often, at most. Chosen by judgement: once in a
#: million channels (docs/faults.md).
CHANCE = 1e-6
#: So many of the highest values are kept, and those count that are so near the highest, as a part
#: of the swing. Chosen by judgement: they bound memory and leave enough values below the highest to
#: tell what is usual.
KEPT, BAND = 64, 0.01
#: Values nearer to each other are the same but for rounding, as a part of the value. Chosen by
#: judgement: over what float32 rounds by (6e-8), under the step of a digitiser of 16 bits (3e-5).
ROUNDING = 1e-6
#: Finer steps than this part of the swing are not believed. Chosen by judgement: 16 bits over the
#: swing have steps of 1.5e-5; smaller ones are of arithmetic.
FINEST = 1e-5
#: Where another value comes in more than this part of as many tops, the signal is coarse or repeats
#: itself. Chosen by judgement: a limit comes at least twice as often as any other value
#: (docs/faults.md).
USUAL = 0.5
#: A value that is kept longer is no top [s]. Chosen by judgement: the swing of a foot or hand is
#: near its extreme for less.
LONGEST_S = 0.2


@dataclass(slots=True)
class _RepeatedSide:
    """The highest values of one side, counted upwards, and the tops that end at each."""

    sign: int
    tops: dict[float, FaultSpans] = field(default_factory=dict)
    last: float = math.nan

    @property
    def extreme(self) -> float:
        return max(self.tops, default=-math.inf)

    def update(self, window: Window, c: int, longest: float) -> None:
        row = self.sign * window.core[c]
        floor = min(self.tops) if len(self.tops) >= KEPT else -math.inf
        for value in np.unique(row[row >= floor])[-KEPT:].tolist():
            at = np.flatnonzero(row == value)
            runs = np.split(at, np.flatnonzero(np.diff(at) > 1) + 1)
            spans = self.tops.setdefault(value, FaultSpans())
            for run in runs:
                if len(run) <= longest and not (run[0] == 0 and self.last == value):
                    first = int(run[0])
                    spans.add(window.time_ns(first), window.time_ns(first + len(run)), len(run))
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
        other_events = max(
            tops.events for value, tops in self.tops.items() if value != self.extreme
        )
        if again < 1 or not len(apart) or other_events > USUAL * (again + 1):
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
        self._sides = {c: (_RepeatedSide(1), _RepeatedSide(-1)) for c in stream.columns_of(WORN)}
        self._longest = max(2.0, LONGEST_S * stream.rate_hz)
        self._sample_count = 0

    def update(self, window: Window) -> None:
        """Take the next window."""
        self._sample_count += len(window)
        for c, sides in self._sides.items():
            if np.isfinite(window.core[c]).all() and len(window):
                for side in sides:
                    side.update(window, c, self._longest)

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
            repeated_sides = [s for s in sides if s.extreme >= least and s.chance(swing) < CHANCE]
            if repeated_sides:
                yield self._clipped(self.stream.channels[c], repeated_sides)

    def _clipped(self, channel: Channel, sides: list[_RepeatedSide]) -> Finding:
        tops = [side.tops[side.extreme] for side in sides]
        at = " and ".join(
            f"{readable(s.sign * s.extreme * channel.scale)} {channel.unit}" for s in sides
        )
        scale = near_scale(channel, max(side.extreme for side in sides) * channel.scale)
        share = sum(t.samples for t in tops) / self._sample_count
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
