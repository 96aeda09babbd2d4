"""First breaks: the first arrival of a shot at every geophone of a line.

An arrival is the largest rise over everything before it in the record: the logarithm of the power
in the next milliseconds over the highest power so far, of the signal and of its slope. Noise that
lasts, however strong, does not rise. Arrivals are tracked over the line by Viterbi (A. J. Viterbi,
IEEE Trans. Inf. Theory 13, 1967): from geophone to geophone no later than the slowest wave comes,
away from the source and not towards it where its place is known, not long before the recorder's
trigger where there is one, and sooner rather than later. Forwards and backwards, that gives for
each moment by how much the best way through it is worse than the best of all: its deficit.

The onset beside a rise is where Akaike's criterion of variances is least (N. Maeda, J. Seismol.
Soc. Japan 38, 1985) in windows of several lengths; their median is the pick, their spread a part
of its uncertainty. A pick off the line through its neighbours is looked for again on that line.
What is left of its distance from the line, and other moments with little deficit, add to it.

A record ends at a gap or a fixed time after its shot; then it is decided as a whole.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated

import numpy as np

from groundtrace_codecs.events import TRIGGER, Label, Note, Pick, Quantity
from groundtrace_codecs.signals import NS_PER_S, SEISMIC_QUANTITIES, SignalBlock

from .. import kernels
from ..dsp.filters import SampleClock, SampleHistory, SmoothedSlope, planar
from ..dsp.noise import cell_length
from ..pipeline.gates import Candidates, Level, Refractory
from ..pipeline.parameters import gate, measured
from ..pipeline.source import BRIDGE_S
from ..pipeline.stage import Context, Frames, Input, Memory, Stage
from .trace import FRAME_S, TRACE, FrameTrace, trace_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

#: Windows of the criterion before and after a rise [s]; each pair is one. Chosen by trial on
#: simulated lines, seeds 1 to 40, and on either line of refrapy-seg2: longer ones come to other
#: waves. bench/first_breaks.py reports other seeds, and each line with what the other chose.
BEFORE_S, AFTER_S = (0.01, 0.02), (0.005, 0.01)
#: Correlation time of the signal [s]. Chosen by trial as the windows.
CORRELATION_S = 0.001
#: Least samples of a window on each side. Source: definition, the criterion leaves out three at
#: both ends.
LEAST_SAMPLES = 6
#: Largest rise that counts [nepers of power]. Chosen by trial as the windows: what is 35 dB over
#: all before needs no more to be an arrival, and the next wave shall not outweigh it.
MOST_RISE = 8.0
#: A rise shows from so much signal on [s]. Chosen by judgement: a period of what geophones pass.
LEAD_S = 0.001
#: A record is also searched for arrivals so long after its end, where they add nothing [s]: the
#: track may leave the record. Chosen by judgement: the longest way of a wave along a line.
BEYOND_S = 0.3
#: The track may be off its speed by this much from geophone to geophone [s]. Chosen by judgement:
#: weathered ground differs by so much.
SLACK_S = 0.002
#: Fastest wave [m/s]: nothing comes sooner. Source: P waves in crystalline rock, W. M. Telford, L.
#: P. Geldart, R. E. Sheriff, Applied Geophysics, 1990, table 4.1.
FASTEST_MPS = 7000.0
#: Neighbours on each side that make a line; a pick farther off than this [s], and than three
#: deviations of theirs, is looked for again. Chosen by judgement: layers change slowly.
REACH, OFF_S = 3, 0.003
#: Part of the windows' spread that is uncertainty, and the least of it [s]. Chosen by trial on line
#: 1 of refrapy-seg2 and simulated lines, seeds 1 to 60, for 60 to 80 % inside;
#: bench/first_breaks.py reports line 2 and other seeds.
SPREAD, LEAST_S = 0.6, 0.0002
#: Moments so far from a pick are others [s]. Chosen by judgement: farther than windows differ.
APART_S = 0.005
#: Nepers of rise that a channel of a shot has. Chosen by judgement: 9 dB; noise rises by less.
RISES = 2.0
#: A trigger is not believed where tracks without it have so much more rise in the mean of channels.
#: Chosen by judgement: weak blows before a shot gain less.
DOUBT = 1.0
#: No evidence at all [nepers]. Chosen by judgement: more than all channels have.
NEVER = -1e4
#: In a long run, channels of a shot rise within so much time; what comes a little earlier is of it
#: [s]. Chosen by judgement: a shot shows itself near its source first.
TOGETHER_S, AHEAD_S = 0.06, 0.1
#: The trigger of a run may come so long before its first sample [s]. Chosen by judgement: longer
#: than any recorder waits, shorter than from shot to shot.
AHEAD_OF_RUN_S = 1.0
#: Standard deviations of a normal law in its median absolute deviation. Source: definition.
MAD_TO_SIGMA = 1.4826
#: Channels no farther apart count as this far [m]. Chosen by judgement: two at one place.
LEAST_APART_M = 0.1
#: Geophones nearest to the source on one side that tell whether the trigger is late, how far their
#: times may be from a line besides what the picks claim [s], and by how many deviations it is late.
#: Chosen by trial on simulated lines, seeds 1 to 100: 31 of 73 late triggers told and none of 344
#: others; bench/first_breaks.py reports other seeds.
NEAREST, BENT_S, SURE = 5, 0.0007, 3.0


@dataclass(frozen=True, slots=True)
class FirstBreakParameters:
    """Parameters of :class:`FirstBreaks`."""

    power_s: Annotated[float, measured("s", "Signal after a moment that rises.", gt=0)] = 0.005
    smooth_s: Annotated[float, measured("s", "Length of the slope's Hann smoothing.", gt=0)] = 0.004
    slope_s: Annotated[float, measured("s", "Base of the centred slope.", gt=0)] = 0.003
    slowest_mps: Annotated[float, measured("m/s", "Slowest wave along the line.", gt=0)] = 150.0
    slowness: Annotated[
        float, measured("m/s", "Cost of a slow wave: nepers per s/m and geophone.", ge=0)
    ] = 400.0
    spacing_m: Annotated[float, measured("m", "Between geophones of unknown place.", gt=0)] = 5.0
    trigger: Annotated[bool, measured("1", "Use the recorder's trigger where there is one.")] = True
    late_s: Annotated[float, measured("s", "How late a trigger may come.", ge=0)] = 0.02
    record_s: Annotated[float, measured("s", "Longest record that is one shot's.", gt=0)] = 4.0
    after_s: Annotated[float, measured("s", "Signal after a shot in longer ones.", gt=0)] = 1.0
    floor: Annotated[float, measured("1", "Lowest rise kept as a candidate.", ge=0)] = 0.5
    deficit: Annotated[float, gate("1", "Largest loss against the best track.", ge=0)] = 0.001
    share: Annotated[float, gate("1", "Least part of channels that rise.", ge=0)] = 0.25
    uncertainty_s: Annotated[float, gate("s", "Largest uncertainty of a pick.", ge=0)] = 0.05
    refractory_s: Annotated[float, gate("s", "Least time between two shots.", ge=0)] = 0.5


@dataclass(frozen=True, slots=True)
class _Line:
    """The channels in the order of the line.

    Attributes
    ----------
    order
        Shape (n_channels,): channel at each place along the line.
    positions_m
        Shape (n_channels, 2): of each channel [m].
    along_m
        Shape (n_channels,): how far along the line each channel is.
    axis
        Shape (2,): direction of the line.
    located
        Whether places are known.
    """

    order: NDArray[np.intp]
    positions_m: Array
    along_m: Array
    axis: Array
    located: bool

    @classmethod
    def of(cls, context: Context, spacing_m: float) -> _Line:
        """Return the line of a stream; of unknown places, evenly spaced in the channels' order."""
        channels = context.stream.channels
        places = [c.position_m for c in channels]
        if all(p is not None for p in places) and context.geometry.unit == "m":
            positions_m = np.array([p[:2] for p in places if p is not None], np.float64)
        else:
            positions_m = np.zeros((0, 2))
        located = len(positions_m) > 1 and bool(np.ptp(positions_m, axis=0).max() > 0)
        if not located:
            positions_m = np.stack(
                [spacing_m * np.arange(len(channels)), np.zeros(len(channels))], 1
            )
        centred = positions_m - positions_m.mean(axis=0)
        axis = np.linalg.svd(centred)[2][0] if len(positions_m) > 1 else np.array([1.0, 0.0])
        along = centred @ axis
        return cls(np.argsort(along, kind="stable"), positions_m, along, axis, located)

    def source_m(self, trigger: Label | None) -> tuple[float, Array] | None:
        """Return how far along the line a shot is, and from each channel; None if unknown."""
        if trigger is None or trigger.x_m is None or trigger.y_m is None or not self.located:
            return None
        position = np.array([trigger.x_m, trigger.y_m])
        along = float((position - self.positions_m.mean(axis=0)) @ self.axis)
        return along, np.hypot(*(self.positions_m - position).T)


@dataclass(frozen=True, slots=True)
class _Shot:
    """What is known of a shot before its record is looked at.

    Attributes
    ----------
    trigger_s
        Of the recorder, after the first sample; None where there is none.
    source
        How far along the line it is [m], and how far from each channel; None where unknown.
    from_s
        Nothing is sought before.
    """

    trigger_s: float | None
    source: tuple[float, Array] | None
    from_s: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class _Neighbours:
    """Which tracked channels make the line that each one is compared with.

    Attributes
    ----------
    beside
        Of each channel its neighbours on its side of the source; none where fewer than three.
    along_m
        Shape (n,): how far along the line the channels are.
    """

    beside: tuple[NDArray[np.intp], ...]
    along_m: Array

    @classmethod
    def of(cls, line: _Line, channels: NDArray[np.intp], shot: _Shot) -> _Neighbours:
        """Return the neighbours of channels, a geophone at the source being on no side."""
        along = line.along_m[channels]
        side = np.zeros(len(along)) if shot.source is None else np.sign(along - shot.source[0])
        beside: list[NDArray[np.intp]] = [np.empty(0, np.intp)] * len(along)
        for one in np.unique(side):
            side_channels = np.flatnonzero(side == one)
            side_channels = side_channels[np.argsort(along[side_channels], kind="stable")]
            for i, c in enumerate(side_channels.tolist()):
                near = np.delete(side_channels[max(0, i - REACH) : i + REACH + 1], min(i, REACH))
                if len(near) > 2 and np.ptp(along[near]) > 0:
                    beside[c] = near
        return cls(tuple(beside), along)

    def off(self, onset: Array) -> tuple[Array, Array]:
        """Return how late each onset is on the line through its neighbours, and their scatter.

        The line's slope is the median of those of all pairs (P. K. Sen, J. Am. Stat. Assoc. 63,
        1968); both are 0 without a line.
        """
        late, scatter = np.zeros(len(onset)), np.zeros(len(onset))
        for c, near in enumerate(self.beside):
            if not len(near):
                continue
            x, y = self.along_m[near] - self.along_m[c], onset[near]
            one, other = np.triu_indices(len(near), 1)
            apart = x[other] - x[one]
            far = apart != 0
            left = y - x * np.median((y[other] - y[one])[far] / apart[far])
            middle = np.median(left)
            late[c] = onset[c] - middle
            scatter[c] = MAD_TO_SIGMA * np.median(np.abs(left - middle))
        return late, scatter


@dataclass(frozen=True, slots=True, eq=False)
class _Picks:
    """Candidates of a record; those on the track come first.

    Attributes
    ----------
    onset, uncertainty
        Shape (n,) [samples of the record].
    channel, rise, deficit
        Shape (n,).
    share
        Part of the live channels that rise on the track.
    tracked
        How many are on the track.
    """

    onset: Array
    uncertainty: Array
    channel: NDArray[np.intp]
    rise: Array
    deficit: Array
    share: float
    tracked: int

    def late(self, line: _Line, shot: _Shot, rate_hz: float) -> tuple[float, int] | None:
        """Return by how much the trigger is late at least [s], and how many geophones tell.

        Away from a shot, waves of deeper and faster layers overtake: travel times curve downwards.
        So the straight line through the first of them meets the source later than the wave left.
        None where nothing shows that it is late.
        """
        if shot.source is None or shot.trigger_s is None:
            return None
        along, far = shot.source
        picks, most = np.arange(self.tracked), None
        for side in (-1, 1):
            near = picks[np.sign(line.along_m[self.channel[picks]] - along) == side]
            near = near[np.argsort(far[self.channel[near]], kind="stable")][:NEAREST]
            x, y = far[self.channel[near]], self.onset[near] / rate_hz - shot.trigger_s
            sigma = np.hypot(self.uncertainty[near] / rate_hz, BENT_S)
            if len(near) < NEAREST or np.ptp(x) == 0:
                continue
            (slope, meets), covariance = np.polyfit(x, y, 1, w=1 / sigma, cov="unscaled")
            surely = float(-meets - SURE * np.sqrt(covariance[1, 1]))
            if slope >= 0 and surely > 0:
                most = max(most or 0.0, surely)
        return None if most is None else (most, NEAREST)


class FirstBreaks(Stage):
    """The first break is the largest rise of a record, tracked over the channels of a line."""

    Parameters = FirstBreakParameters
    takes = (Input(SignalBlock, SEISMIC_QUANTITIES), Input(Label, required=False))
    gives = (Pick,)
    compiles = ("filters", "frames", "maxima", "picker", "tracking")
    bridges_s = BRIDGE_S
    columns = (
        Quantity("rise", "1"),
        Quantity("deficit", "1"),
        Quantity("share", "1"),
        Quantity("uncertainty", "s"),
    )
    trace = trace_of(Quantity("rise", "1"), "signal", "signal")
    gates = (
        Level("deficit", "1", "deficit", at_least=False),
        Level("share", "1", "share"),
        Level("uncertainty", "s", "uncertainty_s", at_least=False),
        Refractory(),
    )

    def __init__(self, parameters: FirstBreakParameters) -> None:
        self.parameters = parameters

    @property
    def memory(self) -> Memory:
        """All before: a record begins where the last one ended; and the longest record."""
        # rounded to whole cells, which are shorter than frames
        return Memory(None, self.parameters.record_s + FRAME_S).behind([TRACE])

    def start(self, context: Context) -> tuple[str, ...]:
        """Begin a run: one record, or a long one that holds several shots."""
        stream = context.stream
        self.rate_hz, self.topic, self.name = stream.rate_hz, context.topic, context.stage
        self.line = _Line.of(context, self.parameters.spacing_m)
        self.cell = cell_length(self.rate_hz)
        self.clock = SampleClock()
        self.history = SampleHistory(1, len(stream.channels))
        self.frames = FrameTrace(self.rate_hz / self.cell, len(stream.channels))
        self.triggers = [x for x in context.labels if x.kind == TRIGGER]
        self.begin = 0  # first sample of the record under way
        return tuple(c.name for c in stream.channels)

    def process(self, block: SignalBlock) -> Iterator[Frames | Candidates | Note]:
        """Take signal; give what the records hold that are complete."""
        if len(block):
            self.clock.add(block)
            self.history.append(planar(block))
        longest = self._whole_cells(self.parameters.record_s)
        while self.history.end - self.begin > longest:
            yield from self._advance(self.begin + longest)

    def flush(self) -> Iterator[Frames | Candidates | Note]:
        """End the record at the end of the run."""
        while self.begin < self.history.end:
            yield from self._advance(self.history.end)
        yield self.frames.flush()

    def _advance(self, stop: int) -> Iterator[Frames | Candidates | Note]:
        """Decide the record that a stretch holds, or let go of a part of the stretch without one.

        A run no longer than a record is one. In a longer one a record ends a fixed time after its
        shot: after the trigger, or after a part of the channels rises.
        """
        start, ends = self.begin, stop == self.history.end
        trigger = self._trigger(start, stop)
        samples = self.history.between(start, stop)
        rise = self._rise(samples)
        if ends and start == 0:
            yield from self._decide(rise, samples, trigger, 0.0)
            end = stop
        else:
            shot = self._shot(rise, trigger)
            after = start + self._whole_cells(self.parameters.after_s)
            if shot is None or (shot + after > stop and not ends):
                end = stop if ends else start + (stop - start) // self.cell // 2 * self.cell
            else:
                end = min(stop, shot + after)
                rise = rise[:, : -(-(end - start) // self.cell)]
                from_s = max(0.0, shot / self.rate_hz - AHEAD_S)
                yield from self._decide(rise, samples[: end - start], trigger, from_s)
        yield self._framed(rise[:, : -(-(end - start) // self.cell)], samples[: end - start])
        self.begin = end
        self.history.drop_before(end)
        self.clock.discard_before(end)

    def _whole_cells(self, time_s: float) -> int:
        """Return a time in samples, rounded to whole cells."""
        return max(1, round(time_s * self.rate_hz / self.cell)) * self.cell

    def _trigger(self, start: int, stop: int) -> Label | None:
        """Return the trigger of the record under way; that of a run may come before it."""
        if not self.parameters.trigger:
            return None
        first_ns = self.clock.time_of(start) - round(AHEAD_OF_RUN_S * NS_PER_S) * (start == 0)
        triggers = [x for x in self.triggers if first_ns <= x.time_ns < self.clock.time_of(stop)]
        return triggers[-1] if start == 0 and triggers else triggers[0] if triggers else None

    def _shot(self, rise: Array, trigger: Label | None) -> int | None:
        """Return at which sample of a stretch a shot begins to show itself; None without one."""
        if trigger is not None:
            since = trigger.time_ns - self.clock.time_of(self.begin)
            return int(since * self.rate_hz / NS_PER_S) // self.cell * self.cell
        width = round(TOGETHER_S * self.rate_hz / self.cell)
        rises = np.where(rise >= RISES, 1.0, 0.0)
        rises[:, : round(AHEAD_S * self.rate_hz / self.cell)] = 0.0  # too little is before
        if rises.shape[1] <= width:
            return None
        together = kernels.maxima.window_maxima(rises, width).mean(axis=0)
        cells = np.flatnonzero(together >= self.parameters.share)
        return int(cells[0] + width - 1) * self.cell if len(cells) else None

    def _rise(self, samples: Array) -> Array:
        """Return the largest rise in each cell of a stretch, shape (n_channels, n_cells)."""
        p, cells = self.parameters, np.arange(0, len(samples), self.cell)
        signal = np.ascontiguousarray(samples.T)
        signal = signal - np.median(signal, axis=1, keepdims=True)
        slope = _slope(signal, self.rate_hz, p.smooth_s, p.slope_s)
        length, lead = (max(2, round(s * self.rate_hz)) for s in (p.power_s, LEAD_S))
        both = np.zeros((len(signal), len(cells)))
        for row, x, y in zip(both, signal, slope, strict=True):
            for one in (x, y):
                risen = np.clip(rise_over_all_before(one, length, lead), 0.0, MOST_RISE)
                row += 0.5 * np.maximum.reduceat(risen, cells)
        return both

    def _framed(self, rise: Array, samples: Array) -> Frames:
        """Return the frames that cells complete."""
        cells = np.arange(0, len(samples), self.cell)
        signal = samples - np.median(samples, axis=0)
        size = np.diff(np.append(cells, len(samples)))
        rows = (
            rise,
            np.maximum.reduceat(np.abs(signal), cells).T,
            (np.add.reduceat(signal**2, cells) / size[:, None]).T,
            np.maximum.reduceat(samples, cells).T,
            np.minimum.reduceat(samples, cells).T,
        )
        return self.frames.add(self.clock.at(self.begin + cells), *rows)

    def _decide(
        self, rise: Array, samples: Array, trigger: Label | None, from_s: float
    ) -> Iterator[Candidates | Note]:
        """Give the candidates of a record, and say where its trigger cannot be right."""
        live = samples.max(axis=0) > samples.min(axis=0)
        trigger_s = None
        if trigger is not None:
            trigger_s = (trigger.time_ns - self.clock.time_of(self.begin)) / NS_PER_S
        source = self.line.source_m(trigger)
        shot = _Shot(trigger_s, source, from_s)
        through = self._through(rise, shot)
        if trigger is not None:
            free = self._through(rise, _Shot(None, source, from_s))
            if free.max() - through.max() > DOUBT * live.sum():
                shot, through = _Shot(None, source, from_s), free
                text = (
                    "the trigger is not used: by far the most rises are not where it has the shot"
                )
                yield Note(trigger.time_ns, f"{self.topic}: {text}", "WARN", self.name)
        picks = self._picked(rise, through, samples, live, shot)
        yield self._candidates(picks)
        if trigger is not None and (late := picks.late(self.line, shot, self.rate_hz)) is not None:
            text = (
                f"the trigger comes at least {late[0] * 1e3:.1f} ms late: by their travel times, "
            )
            text += f"the {late[1]} geophones nearest to the source lead back to before it"
            yield Note(trigger.time_ns, f"{self.topic}: {text}", "WARN", self.name)

    def _through(self, rise: Array, shot: _Shot) -> Array:
        """Return the score of the best track through each cell, shape (n_channels, n_cells)."""
        cell_s = self.cell / self.rate_hz
        beyond = np.zeros((len(rise), round(BEYOND_S / cell_s)))
        evidence = np.concatenate([rise, beyond], axis=1)
        time_s = np.arange(evidence.shape[1]) * cell_s
        evidence[:, time_s < shot.from_s] = NEVER
        if shot.trigger_s is not None:
            far = np.ones(len(rise)) if shot.source is None else shot.source[1]
            slowest = np.inf if shot.source is None else 1 / self.parameters.slowest_mps
            first = shot.trigger_s - self.parameters.late_s + far / FASTEST_MPS
            last = shot.trigger_s + far * slowest + 2 * SLACK_S
            outside = (time_s < first[:, None]) | (time_s > last[:, None])
            evidence[outside] = NEVER
        order = self.line.order
        forward = self._sweep(evidence, order, shot)
        backward = self._sweep(evidence, order[::-1], shot)
        return np.asarray(forward + backward - evidence)

    def _sweep(self, evidence: Array, order: NDArray[np.intp], shot: _Shot) -> Array:
        """Return the score of the best track that ends in each cell, from the first channel on."""
        cell_s, line = self.cell / self.rate_hz, self.line
        score = evidence.copy()
        step = np.empty(evidence.shape[1])
        for before, here in pairwise(order.tolist()):
            apart = max(abs(line.along_m[here] - line.along_m[before]), LEAST_APART_M)
            later = earlier = apart / self.parameters.slowest_mps + SLACK_S
            if shot.source is not None:
                along, far = shot.source
                if (line.along_m[before] - along) * (line.along_m[here] - along) >= 0:
                    away = far[here] > far[before]
                    later, earlier = (later, SLACK_S) if away else (SLACK_S, earlier)
            cost = self.parameters.slowness / apart * cell_s
            reach = int(later / cell_s), int(earlier / cell_s)
            kernels.tracking.best_steps(score[before], *reach, cost, step)
            score[here] += step
        return score

    def _picked(
        self, rise: Array, through: Array, samples: Array, live: NDArray[np.bool_], shot: _Shot
    ) -> _Picks:
        """Return the onsets of the tracked cells and of all other rises of a record."""
        cells = rise.shape[1]
        best, track = through.max(axis=1), through.argmax(axis=1)
        apart = max(1, round(APART_S * self.rate_hz / self.cell))
        peaks = _local_maxima(rise, apart) & (rise >= self.parameters.floor) & live[:, None]
        peaks &= np.abs(np.arange(cells) - track[:, None]) > apart
        tracked = np.flatnonzero(live & (track < cells))
        tracked = tracked[self._moves(samples, tracked, (track[tracked] + 1) * self.cell)]
        others, other_cells = np.nonzero(peaks)
        channel = np.concatenate([tracked, others])
        cell = np.concatenate([track[tracked], other_cells])
        onset, spread = self._onsets(samples, channel, (cell + 1) * self.cell)
        first = len(tracked)
        line = _Neighbours.of(self.line, tracked, shot)
        off, scatter = line.off(onset[:first])
        again = np.flatnonzero(np.abs(off) > np.maximum(OFF_S * self.rate_hz, SURE * scatter))
        if len(again):
            at = np.clip(onset[again] - off[again], 0, len(samples) - 1)
            new, wide = self._onsets(samples, tracked[again], np.rint(at).astype(np.intp))
            nearer = np.abs(new - at) < np.abs(off[again])
            onset[again[nearer]], spread[again[nearer]] = new[nearer], wide[nearer]
            off, _ = line.off(onset[:first])
        distance = np.zeros(len(onset))
        distance[:first] = off
        parts = (SPREAD * spread) ** 2 + distance**2 + (LEAST_S * self.rate_hz) ** 2
        doubt = np.zeros(len(onset))
        doubt[:first] = [_doubt(through[c], apart) * self.cell for c in tracked]
        share = np.mean(rise[tracked, track[tracked]] >= RISES) if len(tracked) else 0.0
        return _Picks(
            onset,
            np.sqrt(parts + doubt**2),
            channel,
            rise[channel, cell],
            np.maximum(best[channel] - through[channel, cell], 0.0),
            float(share) * first / max(1, int(live.sum())),
            first,
        )

    def _candidates(self, picks: _Picks) -> Candidates:
        """Return candidates in order, at the times of their onsets."""
        onset_sample = np.floor(picks.onset)
        after_ns = np.rint((picks.onset - onset_sample) * NS_PER_S / self.rate_hz).astype(np.int64)
        time_ns = self.clock.at(self.begin + onset_sample.astype(np.intp)) + after_ns
        order = np.lexsort((picks.channel, time_ns))
        share = np.full(len(time_ns), picks.share)
        columns = (picks.rise, picks.deficit, share, picks.uncertainty / self.rate_hz)
        value = np.stack(columns, axis=1).astype(np.float32)
        return Candidates(time_ns[order], picks.channel[order].astype(np.int32), value[order])

    def _moves(
        self, samples: Array, channel: NDArray[np.intp], anchor: NDArray[np.intp]
    ) -> NDArray[np.bool_]:
        """Return where a channel does not stand still about a sample, as a dead one does."""
        before, after = (round(max(s) * self.rate_hz) for s in (BEFORE_S, AFTER_S))
        rows = zip(channel.tolist(), anchor.tolist(), strict=True)
        near = (samples[max(0, i - before) : i + after, c] for c, i in rows)
        return np.array([len(x) > 1 and x.max() > x.min() for x in near], np.bool_)

    def _onsets(
        self, samples: Array, channel: NDArray[np.intp], anchor: NDArray[np.intp]
    ) -> tuple[Array, Array]:
        """Return the median of the onsets in all windows about samples, and their deviation."""
        picks, correlation = [], CORRELATION_S * self.rate_hz
        for before_s in BEFORE_S:
            for after_s in AFTER_S:
                before, after = (
                    max(LEAST_SAMPLES, round(s * self.rate_hz)) for s in (before_s, after_s)
                )
                start = np.clip(anchor - before, 0, None)
                length = np.minimum(anchor + after, len(samples)) - start
                window_picks = kernels.picker.onsets(samples, start, length, channel, correlation)
                picks.append((start + window_picks[0], window_picks[1]))
        onset, deviation = np.array(picks).transpose(1, 0, 2)
        return np.median(onset, axis=0), np.hypot(
            onset.std(axis=0), np.sqrt((deviation**2).mean(axis=0))
        )


def _slope(signal: Array, rate_hz: float, smooth_s: float, slope_s: float) -> Array:
    """Return the slope of a smoothed signal; what its ends lack is taken from beside them."""
    smoothed = SmoothedSlope(rate_hz, smooth_s, slope_s)
    slope = np.concatenate([smoothed(signal)[1], smoothed.flush()[1]], axis=1)
    edge = min(smoothed.delay, slope.shape[1] // 3)
    slope[:, :edge] = slope[:, edge : 2 * edge][:, ::-1]
    slope[:, slope.shape[1] - edge :] = 0.0
    return slope


def rise_over_all_before(x: Array, length: int, lead: int) -> Array:
    """Return the logarithm of the power of the samples from each on over the highest before.

    Parameters
    ----------
    x
        Shape (n,): a signal without offset.
    length
        Samples whose power is taken, and least samples before; in the first ones, all before.
    lead
        Samples before which nothing rises.

    Returns
    -------
    Shape (n,): 0 where too few samples come before or after, or nothing was before.
    """
    total = np.concatenate([[0.0], np.cumsum(x * x)])
    rise = np.zeros(len(x))
    if len(x) < 2 * length:
        return rise
    power = (total[length:] - total[:-length]) / length
    highest = np.maximum.accumulate(power)
    at, early = np.arange(lead, len(power)), np.arange(1, length)
    before = np.concatenate([total[early] / early, highest[: len(power) - length]])[lead - 1 :]
    after = power[at]
    valid = (before > 0) & (after > 0)
    rise[at[valid]] = np.log(after[valid] / before[valid])
    return rise


def _local_maxima(line: Array, reach: int) -> NDArray[np.bool_]:
    """Return where a line is the largest within a reach on both sides, shape of the line."""
    padded = np.pad(line, ((0, 0), (reach, reach)), constant_values=-np.inf)
    highest: NDArray[np.bool_] = line >= kernels.maxima.window_maxima(padded, 2 * reach + 1)
    highest[:, 1:] &= line[:, 1:] > line[:, :-1]
    return highest


def _doubt(through: Array, apart: int) -> float:
    """Return how far from the best cell others are that may be meant: root mean square [cells].

    Each local maximum counts by how much worse the best track through it is.
    """
    best = int(through.argmax())
    inner = through[1:-1]
    at = np.flatnonzero((inner > through[:-2]) & (inner >= through[2:])) + 1
    at = at[np.abs(at - best) > apart]
    weight = np.exp(np.maximum(through[at] - through[best], -50.0))
    return float(np.sqrt(np.sum(weight * (at - best) ** 2.0) / (1.0 + weight.sum())))
