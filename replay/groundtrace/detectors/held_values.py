"""Values that stand still: dead and late channels, dropouts, flat tops of a clipped signal.

All are runs of equal samples. The corner separates a fault from a coarse or slow signal. A smooth
signal that rests on one step of its digitiser comes and goes the slower the longer it rests, by its
curvature; so a run of equal samples with steep signal right before and after is not the signal's
own. No rate and no amplitude enters.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace_codecs.events import readable
from groundtrace_codecs.signals import G0_MPS2, SEISMIC_QUANTITIES

from ..dsp.robust import medians
from .signal_faults import FaultSpans, Finding, Rails, percent, times

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.signals import Channel, Stream

    from .signal_faults import Window

    Row = NDArray[np.floating]

#: Context looked at on each side of a run, and the least of it that tells anything [samples].
#: Chosen by judgement: a corner shows in few samples, and later ones belong to what follows.
NEAR, LEAST_NEAR = 8, 4
#: A corner is so many times steeper than a smooth signal can be next to its rest, and at least so
#: many steps of the digitiser a sample. Chosen by judgement: a margin over the bound of a smooth
#: signal, 2 / n + 16 / n^2 steps a sample (docs/faults.md).
CORNER, LEAST_SLOPE = 1.7, 1.0
#: Shorter runs are no flat top; from here on a channel is constant rather than dropped out. Chosen
#: by judgement: two equal samples are rounding; no wave stands still for a second, nor at slow
#: rates for 20 samples.
SHORTEST, CONSTANT_S, CONSTANT_SAMPLES = 3, 1.0, 20
#: Smaller changes are rounding, as a part of the value; nearly the smallest change: this quantile.
#: Chosen by judgement: over what a double rounds by; a tenth leaves room for rare differences
#: smaller than a step of the digitiser.
ROUNDING, STEP_PART = 1e-12, 0.1
#: Chance that samples next to each other are equal all along a dropout, as a power of ten. Chosen
#: by judgement: an hour at 20 kHz has 7e7 samples.
CHANCE = -9.0
#: Short rests tell how often that is by chance, where there are so many; never taken for more.
#: Chosen by judgement: fewer rests tell no rate, and near 1 no run would be too long.
ENOUGH, MOST_EQUAL = 8, 0.9


@dataclass(slots=True)
class Line:
    """What stands still in one channel.

    Attributes
    ----------
    rails, dropouts, constant
        Flat tops, short and long runs.
    values
        Values that long runs stood at, the first few.
    late_ns
        When a channel came that gave nothing at first [ns]; None where it did not.
    step
        Nearly the smallest change from sample to sample: that of a coarse digitiser, or tiny.
    equal
        How often samples of the present window are equal by chance.
    began, began_ns, before, value
        The rest that goes on: its first sample, its time, the slope before it, its value.
    """

    rails: Rails = field(default_factory=Rails)
    dropouts: FaultSpans = field(default_factory=FaultSpans)
    constant: FaultSpans = field(default_factory=FaultSpans)
    values: list[float] = field(default_factory=list)
    late_ns: int | None = None
    step: float = float("inf")
    began: int = 0
    began_ns: int = 0
    before: float = float("nan")
    equal: float = 0.0
    value: float = float("nan")


class StuckValues:
    """Looks for runs of equal samples.

    Parameters
    ----------
    stream
        Its rate and channels.
    columns
        The channels that are looked at: those whose quantity is never at rest for long.
    brief
        Those of them in which short rests count: a magnetometer's values are stale now and then.
    """

    def __init__(self, stream: Stream, columns: Sequence[int], brief: Sequence[int]) -> None:
        self.stream = stream
        self._lines = {c: Line() for c in columns}
        self._brief = frozenset(brief)
        self._long = max(CONSTANT_SAMPLES, round(CONSTANT_S * stream.rate_hz))
        self._sample_count = 0
        self._fresh, self._first_run = True, True
        self._end, self._end_ns = 0, 0

    def update(self, window: Window) -> None:
        """Take the next window."""
        self._end = window.first + len(window)
        self._end_ns = window.time_ns(len(window))
        for c, line in self._lines.items():
            if self._fresh:
                line.began, line.began_ns = window.first, window.start_ns
                line.before, line.value = float("nan"), float(window.core[c, 0])
            self._look(window, c, line)
        self._fresh = False
        self._sample_count += len(window)

    def gap(self) -> None:
        """End the runs that are open."""
        if self._fresh:
            return
        for c, line in self._lines.items():
            run = _Run(line.began, self._end, line.began_ns, self._end_ns, line.value)
            self._take(c, line, run, line.before, float("nan"))
        self._fresh, self._first_run = True, False

    def _look(self, window: Window, c: int, line: Line) -> None:
        """Find the runs of a channel that end in a window."""
        row, left = window.values[c], window.left
        here = row[left - 1 if left else 0 : left + len(window)]
        if np.isnan(here).all():
            return
        highest, lowest = float(np.nanmax(here)), float(np.nanmin(here))
        line.rails.reach(highest, lowest)
        jumps = np.abs(np.diff(here))
        # what was scaled before it was written is equal but for rounding
        jumps[jumps <= ROUNDING * max(abs(highest), abs(lowest))] = 0
        begins = np.flatnonzero(jumps) + (0 if left else 1)
        if not len(begins):
            return
        line.step = min(line.step, _step(jumps))
        starts = np.concatenate([[line.began - window.first], begins])
        for i, before, after in self._worth(row, left, starts, line):
            first, end = int(starts[i]), int(starts[i + 1])
            run = _Run(
                window.first + first,
                window.first + end,
                window.time_ns(first) if i else line.began_ns,
                window.time_ns(end),
                float(row[left + end - 1]) if left + end else line.value,
            )
            self._take(c, line, run, before, after)
        last = starts[-1:]
        line.began, line.began_ns = window.first + int(last[0]), window.time_ns(int(last[0]))
        line.before = float(_slopes(row, left + last, -1)[0])
        line.value = float(row[left + int(last[0])])

    def _worth(
        self, row: Row, left: int, starts: NDArray[np.intp], line: Line
    ) -> Iterator[tuple[int, float, float]]:
        """Yield the runs worth a look, and their slopes: long ones, and those with corners."""
        lengths = np.diff(starts)
        rows = np.flatnonzero(lengths >= SHORTEST)
        # no slope is steeper than the whole row is high: most runs are too short by that alone
        line.equal = _equal(lengths)
        least = _unlikely(np.array(np.nanmax(row) - np.nanmin(row)), line)
        values = row[left + starts[rows + 1] - 1]
        rows = rows[(lengths[rows] >= least) | line.rails.near(values)]
        if not len(rows):
            return
        before = _slopes(row, left + starts[rows], -1)
        if rows[0] == 0:
            before[0] = line.before
        long = lengths[rows] >= self._long
        steep = long | (before >= _steep(lengths[rows]) * line.step)
        rows, before, long = rows[steep], before[steep], long[steep]
        after = _slopes(row, left + starts[rows + 1], 1)
        least = _unlikely(np.fmin(before, after), line)
        values = row[left + starts[rows + 1] - 1]
        odd = (lengths[rows] >= least) | line.rails.near(values)
        retained = long | ((after >= _steep(lengths[rows]) * line.step) & odd)
        yield from zip(
            rows[retained].tolist(),
            before[retained].tolist(),
            after[retained].tolist(),
            strict=True,
        )

    def _take(self, c: int, line: Line, run: _Run, before: float, after: float) -> None:
        """Judge a run by its length and the slopes on both sides; NaN where there is nothing."""
        if run.length < SHORTEST or np.isnan(run.value):
            return
        sides = [x for x in (before, after) if not np.isnan(x)]
        steep = bool(sides) and min(sides) >= _steep(run.length) * line.step
        span_ns = run.start_ns, run.end_ns
        if run.length >= self._long:
            seismic = self.stream.channels[c].quantity in SEISMIC_QUANTITIES
            moving = bool(sides) and max(sides) >= line.step
            if steep or not sides or (seismic and moving):
                self._constant(line, run)
        elif len(sides) == 2 and steep and c in self._brief:
            railed = run.value != 0 and line.rails.take(run.value, span_ns, run.length, line.step)
            least = _unlikely(np.array(min(sides)), line)
            if not railed and run.length >= least:
                line.dropouts.add(*span_ns, run.length)

    def _constant(self, line: Line, run: _Run) -> None:
        if self._first_run and run.start == 0 and run.end < self._end:
            line.late_ns = run.end_ns
        line.constant.add(run.start_ns, run.end_ns, run.length)
        if run.value not in line.values and len(line.values) < 3:
            line.values.append(run.value)

    def findings(self) -> Iterator[Finding]:
        """Yield what was found in each channel."""
        for c, line in self._lines.items():
            yield from held_findings(self.stream, c, line, self._sample_count)


@dataclass(frozen=True, slots=True)
class _Run:
    """Equal samples: half-open span in samples of the run of blocks and in time, and the value."""

    start: int
    end: int
    start_ns: int
    end_ns: int
    value: float

    @property
    def length(self) -> int:
        return self.end - self.start


def _step(jumps: Row) -> float:
    """Return what is nearly the smallest change from sample to sample, infinite with none."""
    moved = jumps[jumps > 0]
    if not len(moved):
        return float("inf")
    at = int(STEP_PART * len(moved))
    return float(np.partition(moved, at)[at])


def _slopes(row: Row, at: NDArray[np.intp], side: int) -> NDArray[np.float64]:
    """Return the median changes from sample to sample before or from places; NaN with too few.

    Parameters
    ----------
    row
        Shape (n,).
    at
        Shape (m,): index of the first sample of a run, or of the first after it.
    side
        -1 looks before, 1 from there on.
    """
    index = at[:, None] + (np.arange(-NEAR - 1, 0) if side < 0 else np.arange(NEAR + 1))
    inside = (index >= 0) & (index < len(row))
    values = np.where(inside, row[np.clip(index, 0, len(row) - 1)], np.nan)
    jumps = np.abs(np.diff(values, axis=1))
    return np.where(inside.sum(axis=1) > LEAST_NEAR, medians(jumps), np.nan)


def _equal(lengths: NDArray[np.intp]) -> float:
    """Return how often a sample equals the one before by chance, as its rests tell.

    Of rests of one, two, three and four samples each is by that chance rarer than the one before.
    """
    count = np.bincount(np.minimum(lengths, 5), minlength=5)[1:5].astype(np.float64)
    sufficient = count[:-1] >= ENOUGH
    return min(
        float(np.max(count[1:] / np.fmax(count[:-1], 1), where=sufficient, initial=0)), MOST_EQUAL
    )


def _unlikely(slope: NDArray[np.float64], line: Line) -> NDArray[np.float64]:
    """Return how many equal samples are no chance next to a signal of such slopes.

    Two samples next to each other are equal by chance less often than once in 2 slope / step.
    """
    chance = np.fmax(0.5 / np.fmax(slope / line.step, LEAST_SLOPE), line.equal)
    least: NDArray[np.float64] = 1 + CHANCE / np.log10(chance)
    return least


def _steep(length: Any) -> Any:
    """Return which slope makes a corner of a rest of so many samples [steps a sample].

    A parabola that rests on one step for n samples bends by at most 4 / n^2 steps, which makes a
    slope of 2 / n + 4 k / n^2 at k samples from its rest; k is the middle of what is looked at.
    """
    return np.maximum(CORNER * (2 / length + 2 * NEAR / length**2), LEAST_SLOPE)


def held_findings(stream: Stream, column: int, line: Line, total_samples: int) -> Iterator[Finding]:
    """Yield what stands still in one channel."""
    channel = stream.channels[column]
    if line.constant.events:
        yield _constant(stream, channel, line, total_samples)
    rails = list(line.rails.clipped_sides())
    if rails:
        yield _clipped(stream, channel, rails, total_samples)
    if line.dropouts.events:
        yield _dropouts(stream, channel, line.dropouts, total_samples)


def _finding(
    stream: Stream, channel: Channel, kind: str, tally: FaultSpans, total_samples: int, *text: str
) -> Finding:
    share = tally.samples / total_samples
    span = tally.start_ns, tally.end_ns
    return Finding(stream.topic, channel.name, kind, *span, tally.events, share, *text)


def _constant(stream: Stream, channel: Channel, line: Line, total_samples: int) -> Finding:
    tally = line.constant
    at = " and ".join(level(channel, value) for value in line.values)
    if tally.samples == total_samples:
        what, remedy = f"constant at {at} throughout", "look at its cable, or leave it out"
        return _finding(
            stream,
            channel,
            "constant",
            tally,
            total_samples,
            what,
            "nothing is found on it",
            remedy,
        )
    if line.late_ns is not None and tally.events == 1:
        length_s = tally.samples / stream.rate_hz
        return _finding(
            stream,
            channel,
            "late",
            tally,
            total_samples,
            f"appears late: constant at {at} for the first {length_s:.3f} s",
            "until then it is as if it were not there",
            "look at when it was switched on",
        )
    part = percent(tally.samples / total_samples)
    return _finding(
        stream,
        channel,
        "constant",
        tally,
        total_samples,
        f"constant at {at} {times(tally.events)} for 1 s or longer, {part} of the samples",
        *_still(channel),
    )


def _still(channel: Channel) -> tuple[str, str]:
    """Return effect and remedy of a channel that stands still now and then."""
    if channel.quantity == "magnetic_field":
        return "a compass goes on with old values there", "let the phone calibrate before walking"
    return "nothing is found there", "look at its cable and at packets lost"


def _clipped(
    stream: Stream, channel: Channel, rails: list[tuple[float, FaultSpans]], total_samples: int
) -> Finding:
    both = FaultSpans(
        sum(t.events for _, t in rails),
        sum(t.samples for _, t in rails),
        min(t.start_ns for _, t in rails),
        max(t.end_ns for _, t in rails),
    )
    at = " and ".join(level(channel, value) for value, _ in rails)
    part = percent(both.samples / total_samples)
    scale = near_scale(channel, max(abs(value) for value, _ in rails) * channel.scale)
    return _finding(
        stream,
        channel,
        "clipped",
        both,
        total_samples,
        f"clipped at {at}{scale} {times(both.events)}, {part} of the samples",
        *clipped_effect(channel),
    )


def _dropouts(stream: Stream, channel: Channel, tally: FaultSpans, total_samples: int) -> Finding:
    longest = f"{tally.samples / stream.rate_hz / tally.events * 1e3:.3g} ms each on average"
    return _finding(
        stream,
        channel,
        "dropouts",
        tally,
        total_samples,
        f"is stuck at one value {times(tally.events)}, {longest}",
        "what lies there is missed, and its edges may look like onsets",
        "look at the connection and at packets lost",
    )


def level(channel: Channel, value: float) -> str:
    """Return a stored value in the channel's unit, for people."""
    return f"{readable(value * channel.scale)} {channel.unit}"


#: Worn sensors whose limits are looked for in a replay.
WORN = frozenset({"acceleration", "angular_velocity"})
#: Full scales of accelerometers [m/s2] and gyroscopes [rad/s], and how far from them a calibration
#: and an offset bring them.
FULL_SCALES = {
    "acceleration": [(f"{n} g", n * G0_MPS2) for n in (2, 4, 8, 16)],
    "angular_velocity": [
        (f"{n} deg/s", math.radians(n)) for n in (125, 250, 300, 450, 500, 1000, 2000, 4000)
    ],
}
#: How far from a full scale calibration and offset bring a limit, as a part of it. Chosen by
#: judgement: both are per cents, scales are mostly a factor of two apart.
SCALE_TOLERANCE = 0.08


def full_scale(channel: Channel, level: float) -> str:
    """Return the full scale of a worn sensor that a level [SI] is near; empty where none is."""
    scales = FULL_SCALES.get(channel.quantity, []) if channel.unit != "count" else []
    off = [(abs(level - value) / value, name) for name, value in scales]
    return min((pair for pair in off if pair[0] <= SCALE_TOLERANCE), default=(0.0, ""))[1]


def near_scale(channel: Channel, level: float) -> str:
    """Return words for the full scale that a level [SI] is near; empty where none is."""
    scale = full_scale(channel, level)
    return f", near the full scale of {scale}," if scale else ""


def clipped_effect(channel: Channel) -> tuple[str, str]:
    """Return effect and remedy of a channel that is clipped."""
    if channel.quantity in WORN:
        return (
            "it moved further than is recorded: what is integrated goes astray there",
            "record with a wider range",
        )
    return (
        "amplitudes there are lower bounds, onsets stay",
        "record with less gain or a wider range",
    )
