"""The account of picks: late, early, missed and false ones, channel by channel, with the reason.

Picks are compared with true arrivals. Where truth has none, the arrivals of a step are judged by
each other, as part of its location: see :mod:`.why_places`.

Time comes first: a pick near an arrival that does not answer it is late or early by so much. Only
where there is none a gate, a filter or a silent channel is looked for. Reasons are in the words of
the stage that picked.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.events import SIMULATOR, readable, unit_after
from groundtrace_codecs.signals import NS_PER_S

from ..errors import RecordingError
from ..evaluation.picks import ANSWER_S, RIGHT_S, pick_residuals, pick_state
from .reasons import (
    FRAME_NS,
    Chain,
    accepted_picks,
    below,
    closeness,
    links,
    onsets_of,
    readings,
    silence,
    silent,
    timed,
    without_filter,
)
from .unfiltered import passes_levels

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Label, Pick

    from ..evaluation.picks import PickResiduals
    from ..pipeline.results import Evidence, StageEvidence
    from .reasons import GateReading

    Array = NDArray[np.float64]

#: A constant explains the errors of a channel where it gains so much (BIC of a Laplace law, whose
#: scale is the mean absolute error), in at least so many picks. Source: "very strong", R. E. Kass,
#: A. E. Raftery, Bayes factors, J. Am. Stat. Assoc. 90 (1995), section 3.2; the picks chosen by
#: judgement.
STEADY_GAIN, STEADY_PICKS = 10.0, 6
#: A constant at which no error is left is reckoned with this one [s]: no picker is finer. Chosen by
#: judgement: a sample at 20 kHz.
LEAST_SCATTER_S = 5e-5


@dataclass(frozen=True, slots=True)
class PickCounts:
    """How many picks are in each state."""

    right: int
    late: int
    early: int
    missed: int
    false: int

    @classmethod
    def of(cls, states: Iterable[str]) -> PickCounts:
        """Count states."""
        count = Counter(states)
        return cls(*[count[f.name] for f in fields(cls)])


@dataclass(frozen=True, slots=True)
class ChannelPicks:
    """The picks of a channel: how many of each state, and how far off they usually are [ms].

    ``clock`` and ``latency`` say that they are late or early by nearly the same time, and why:
    see :class:`Steady`.
    """

    channel: str
    counts: PickCounts
    median_ms: float
    clock: bool
    latency: bool


@dataclass(frozen=True, slots=True)
class Steady:
    """A channel whose picks are late or early by nearly the same time.

    Attributes
    ----------
    cause
        ``latency``, the picker's: true arrivals that were read off the trace share its clock, and
        what all channels have alike is none of one of them. ``clock`` where true arrivals were
        computed and the other channels are not so late.
    offset_s
        By how much they are late (< 0: early), the median [s].
    before_s, after_s
        Mean size of the errors, as they are and without it [s].
    picks
        How many picks.
    gain
        By how much it explains them better than no constant (BIC).
    others_s
        The median of the other channels' [s]; NaN without any.
    """

    cause: str
    offset_s: float
    before_s: float
    after_s: float
    picks: int
    gain: float
    others_s: float

    @property
    def text(self) -> str:
        """The same for people."""
        of = f"{timed(self.offset_s)} in the median of its {self.picks} picks"
        left = f"without that their mean error is {self.after_s * 1e3:.2f} ms, "
        left += f"{self.before_s * 1e3:.2f} ms with it (BIC better by {self.gain:.0f})"
        if self.cause == "clock":
            return f"{of}, the other channels are {timed(self.others_s)}: its clock; {left}"
        return f"{of}: the picker's latency; {left}"


def steady(truth: Sequence[Label], errors_s: Array, tolerance_s: float) -> dict[str, Steady]:
    """Return the channels that are late or early by nearly the same time."""
    names = list(dict.fromkeys(label.channel for label in truth))
    errors = {name: _errors_of(truth, errors_s, name) for name in names}
    medians = {
        name: float(np.median(channel_errors))
        for name, channel_errors in errors.items()
        if len(channel_errors)
    }
    constant = {}
    for name, channel_errors in errors.items():
        if len(channel_errors) < STEADY_PICKS or abs(medians[name]) <= tolerance_s:
            continue
        before_s, after_s = (float(np.abs(channel_errors - c).mean()) for c in (0.0, medians[name]))
        ratio = before_s / max(after_s, LEAST_SCATTER_S)
        gain = 2 * len(channel_errors) * float(np.log(ratio)) - float(np.log(len(channel_errors)))
        if gain < STEADY_GAIN:
            continue
        rest = [median for other, median in medians.items() if other != name]
        others_s = float(np.median(rest)) if rest else float("nan")
        computed = all(x.author == SIMULATOR for x in truth if x.channel == name)
        alone = abs(medians[name] - others_s) > tolerance_s
        cause = "clock" if computed and alone else "latency"
        constant[name] = Steady(
            cause, medians[name], before_s, after_s, len(channel_errors), gain, others_s
        )
    return constant


def _errors_of(truth: Sequence[Label], errors_s: Array, channel: str) -> Array:
    """Return the errors of the answered arrivals of a channel [s]."""
    channel_errors = errors_s[[label.channel == channel for label in truth]]
    answered: Array = channel_errors[
        [pick_state(error) != "missed" for error in channel_errors.tolist()]
    ]
    return answered


def by_channel(
    truth: Sequence[Label],
    states: Sequence[str],
    errors_s: Array,
    bad: Sequence[BadPick],
    tolerance_s: float,
) -> tuple[ChannelPicks, ...]:
    """Return the picks of each channel that has true arrivals, by name."""
    constant, channels = steady(truth, errors_s, tolerance_s), []
    for name in dict.fromkeys(label.channel for label in truth):
        channel_states = [
            x for label, x in zip(truth, states, strict=True) if label.channel == name
        ]
        channel_states += [b.state for b in bad if b.channel == name and b.state == "false"]
        errors = _errors_of(truth, errors_s, name)
        channels.append(
            ChannelPicks(
                name,
                PickCounts.of(channel_states),
                float(np.median(errors)) * 1e3 if len(errors) else float("nan"),
                name in constant and constant[name].cause == "clock",
                name in constant and constant[name].cause == "latency",
            )
        )
    return tuple(sorted(channels, key=lambda item: item.channel))


#: A candidate beside an arrival is of it where chance brings one as near and as strong less often
#: than so: the usual 5 % of a test. Source: definition, the usual test.
CHANCE = 0.05


@dataclass(frozen=True, slots=True)
class PickReason:
    """Why a pick is bad: one word, the same for people, and the gates of what was decided there."""

    cause: str
    text: str
    readings: tuple[GateReading, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Picking:
    """A stage that picks, on all of its topics.

    Attributes
    ----------
    evidence
        The result.
    parts
        Of the stage, topic by topic; a channel may be in several, as where a spread was moved.
    tolerance_s
        Largest error of a right pick [s].
    """

    evidence: Evidence
    parts: tuple[StageEvidence, ...]
    tolerance_s: float

    @property
    def stage(self) -> str:
        """Its name."""
        return self.parts[0].spec.stage

    def picks(self) -> list[Pick]:
        """Return its picks of all topics."""
        return [pick for part in self.parts for pick in accepted_picks(part)]

    def of(self, pick: Pick) -> StageEvidence:
        """Return the part that a pick is of."""
        return next(part for part in self.parts if part.spec.topic == pick.topic)

    def recorded(self, channel: str, time_ns: int) -> StageEvidence | None:
        """Return the part whose topic has a signal of a channel at a time; None without any."""
        channel_parts = [part for part in self.parts if channel in part.spec.channels]
        return next((part for part in channel_parts if self._has_signal(part, time_ns)), None)

    def _has_signal(self, part: StageEvidence, time_ns: int) -> bool:
        """Whether a topic has a frame of trace at a time; without a trace, whether no gap."""
        source = self.traced(part)
        if source.spec.trace:
            frames = source.frames.time_ns
            first, last = np.searchsorted(frames, [time_ns - FRAME_NS, time_ns], side="right")
            return bool(last > first)
        gaps = (g for g in self.evidence.gaps if g.topic == part.spec.topic and not g.bridged)
        return not any(g.start_ns <= time_ns < g.end_ns for g in gaps)

    def traced(self, part: StageEvidence) -> StageEvidence:
        """Return the last stage with a trace that picks on the same topic, up to a stage."""
        upto = self._upto(part)
        return next((e for e in reversed(upto) if e.spec.trace), part)

    def before(self, part: StageEvidence) -> tuple[StageEvidence, ...]:
        """Return the stages that pick on the same topic before a stage, the last first."""
        return tuple(e for e in reversed(self._upto(part)) if e.spec.stage != part.spec.stage)

    def _upto(self, part: StageEvidence) -> list[StageEvidence]:
        order = [stage.key for stage in self.evidence.config.stage]
        upto = order[: order.index(part.spec.stage) + 1]
        return [
            e
            for key in upto
            for e in self.evidence.of(key)
            if e.spec.emits == "pick" and e.spec.topic == part.spec.topic
        ]

    def by_chance(self, part: StageEvidence, row: int, off_s: float) -> float:
        """Return how many candidates as strong lie as near to any moment by chance.

        By the rate of those of its channel away from true arrivals, over the time of the
        candidates; NaN, so never little, where the candidates span no time.
        """
        c = part.candidates
        strong = (c.channel == c.channel[row]) & (c.value[:, 0] >= c.value[row, 0])
        return self.rate_hz(part, strong) * 2 * off_s

    def rate_hz(self, part: StageEvidence, rows: NDArray[np.bool_]) -> float:
        """Return how many of some candidates come in a second away from true arrivals."""
        c = part.candidates
        true_ns = np.sort([x.time_ns for x in self.evidence.labels if x.kind == "pick"])
        times = c.time_ns[rows]
        at = np.searchsorted(true_ns, times)
        before = np.abs(times - true_ns[np.maximum(at - 1, 0)])
        after = np.abs(times - true_ns[np.minimum(at, len(true_ns) - 1)])
        away = int((np.minimum(before, after) > ANSWER_S * NS_PER_S).sum())
        length_s = float(np.ptp(c.time_ns)) / NS_PER_S
        return away / length_s if length_s > 0 else float("nan")

    def is_chance(self, part: StageEvidence, row: int, off_s: float) -> bool:
        """Whether the nearest candidate may well lie beside a moment by chance: see :func:`chance`.

        Where the count is not known, it may.
        """
        return not chance(self.by_chance(part, row, off_s)) <= CHANCE

    @property
    def within(self) -> str:
        """The tolerance as a phrase."""
        return f"tolerance {self.tolerance_s * 1e3:g} ms"


def chance(count: float) -> float:
    """Return how often the nearest of chance candidates is as remarkable as one, or more.

    Parameters
    ----------
    count
        How many as strong lie as near by chance: see :meth:`Picking.by_chance`.

    Returns
    -------
    That count is how many lie so near, e, times which part of them is as strong, u. Of the nearest
    of candidates that come at any time, independently, e has a negative exponential law and u any
    value from 0 to 1, so that e u is at most the count with a probability of
    1 - exp(-count) + count E1(count), E1 the exponential integral: more often than the count says,
    as one may be strong and far or weak and near.
    """
    from scipy.special import exp1

    if not count > 0:
        return count
    return float(-np.expm1(-count) + count * exp1(count))


def missed(picking: Picking, channel: str, time_ns: int, first: Pick | None) -> PickReason:
    """Say why nothing answers an arrival.

    Parameters
    ----------
    picking
        The stage that picked.
    channel, time_ns
        Of the true arrival.
    first
        The first pick of the channel after the arrival's impact, too far off to answer it.
    """
    reach = round(ANSWER_S * NS_PER_S)
    near_ns = [
        int(part.candidates.time_ns[row])
        for part in picking.parts
        if channel in part.spec.channels
        for row in _near(part, channel, time_ns, reach)
        if part.accepted[row]
    ]
    if near_ns:
        return _passed_over(picking, near_ns, time_ns, first)
    part = picking.recorded(channel, time_ns)
    if part is None:
        return _no_signal(picking, channel)
    broken = _broken(picking, part, channel, time_ns)
    if broken is not None:
        return broken
    rejected = (
        _rejected(picking, part, channel, time_ns)
        or _filtered(picking, part, channel, time_ns)
        or _astray(picking, part, channel, time_ns)
    )
    if rejected is not None:
        return rejected
    if first is not None:
        off_s = (first.time_ns - time_ns) / NS_PER_S
        text = (
            f"the first pick after the impact comes {timed(off_s)}, {picking.within}: farther off "
            f"than {ANSWER_S * 1e3:g} ms it answers nothing"
        )
        return PickReason("late" if off_s > 0 else "early", text)
    return _nothing_picked(picking, part, channel, time_ns)


def _broken(picking: Picking, part: StageEvidence, channel: str, time_ns: int) -> PickReason | None:
    """Say that the channel stood still or was clipped at an arrival; None where it was not.

    Where there is a candidate at the arrival it is clipped only if it was before as well: what
    comes after a wave may be its own doing, and did not hide it.
    """
    source, reach = picking.traced(part), round(ANSWER_S * NS_PER_S)
    if not source.spec.trace:
        return None
    number = source.spec.channels.index(channel)
    quiet = silence(source, number, time_ns - reach, time_ns + reach)
    at_arrival = _near(source, channel, time_ns, round(picking.tolerance_s * NS_PER_S))
    if quiet.cause == "clipped" and len(at_arrival):
        before = silence(source, number, time_ns - reach - FRAME_NS, time_ns - FRAME_NS)
        return PickReason(quiet.cause, quiet.text) if before.cause == "clipped" else None
    return PickReason(quiet.cause, quiet.text) if quiet.cause in {"dead", "clipped"} else None


def _passed_over(
    picking: Picking, near_ns: list[int], time_ns: int, first: Pick | None
) -> PickReason:
    """Say why a pick near an arrival does not answer it: another one comes first, or the impact."""
    off_s = min((t - time_ns for t in near_ns), key=abs) / NS_PER_S
    if first is not None:
        first_s = (first.time_ns - time_ns) / NS_PER_S
        text = (
            f"the first pick after the impact comes {timed(first_s)}, {picking.within}; the one "
            f"that is {timed(off_s)} is not the first"
        )
        return PickReason("late" if first_s > 0 else "early", text)
    side = "after the next impact" if off_s > 0 else "before the impact"
    text = f"picked {timed(off_s)}, {picking.within}: {side}, so that it does not count for it"
    return PickReason("late" if off_s > 0 else "early", text)


def _no_signal(picking: Picking, channel: str) -> PickReason:
    topics = [part.spec.topic for part in picking.parts if channel in part.spec.channels]
    if not topics:
        return PickReason("gap", f"no stream that {picking.stage} picks has a channel {channel}")
    return PickReason("gap", f"no signal of {channel} was recorded then ({', '.join(topics)})")


def _astray(picking: Picking, part: StageEvidence, channel: str, time_ns: int) -> PickReason | None:
    """Say how late or early the nearest rejected candidate is, where it is no chance neighbour."""
    for stage in (part, *picking.before(part)):
        rows = _near(stage, channel, time_ns, round(ANSWER_S * NS_PER_S))
        rejected = [int(r) for r in rows if not stage.accepted[r]]
        if not rejected:
            continue
        row = min(rejected, key=lambda r: abs(int(stage.candidates.time_ns[r]) - time_ns))
        off_s = (int(stage.candidates.time_ns[row]) - time_ns) / NS_PER_S
        if not picking.is_chance(stage, row, abs(off_s)):
            reason = _gate(stage, row, time_ns)
            text = f"the nearest candidate comes {timed(off_s)}, {picking.within}: {reason.text}"
            return PickReason("late" if off_s > 0 else "early", text, reason.readings)
    return None


def _filtered(
    picking: Picking, part: StageEvidence, channel: str, time_ns: int
) -> PickReason | None:
    """Say that the filter took an arrival out; None where nothing shows that.

    Without it a candidate passes every level, so near that chance seldom brings one, and nearer to
    the arrival than any that is left with the filter: those may be the same wave.
    """
    source, signal = picking.traced(part), picking.evidence.unfiltered
    if signal is None or not source.spec.trace or not signal.at_hand:
        return None
    number, reach = source.spec.channels.index(channel), round(ANSWER_S * NS_PER_S)
    measured = signal.around(source, time_ns)
    unmuted = signal.nearest(source, number, time_ns - reach, time_ns + reach)
    if measured is None or unmuted is None:
        return None
    off_ns = abs(unmuted.time_ns - time_ns)
    passed = passes_levels(measured) & (measured.candidates.channel == number)
    often = -np.expm1(-picking.rate_hz(measured, passed) * 2 * off_ns / NS_PER_S)
    if not often <= CHANCE:
        return None
    left_ns = {
        int(r): abs(int(source.candidates.time_ns[r]) - time_ns)
        for r in _near(source, channel, time_ns, reach)
    }
    nearer = [r for r in left_ns if left_ns[r] <= off_ns]
    if not all(picking.is_chance(source, r, left_ns[r] / NS_PER_S) for r in nearer):
        return None
    if not left_ns:
        return PickReason(*silent(picking.evidence, source, number, time_ns, reach))
    nearest = min(left_ns, key=lambda r: left_ns[r])
    reason = _beside(picking, source, nearest, time_ns)
    text = f"{without_filter(source, unmuted, time_ns)}; with it {reason.text}"
    return PickReason("filter", text, reason.readings)


def _nothing_picked(
    picking: Picking, part: StageEvidence, channel: str, time_ns: int
) -> PickReason:
    """Say what stages before had, or what the signal was."""
    reach = round(ANSWER_S * NS_PER_S)
    source = picking.traced(part)
    number = source.spec.channels.index(channel)
    for stage in picking.before(part):
        times = stage.candidates.time_ns
        rows = [int(r) for r in _near(stage, channel, time_ns, reach) if stage.accepted[r]]
        if rows:
            row = min(rows, key=lambda r: abs(int(times[r]) - time_ns))
            off_s = (int(times[row]) - time_ns) / NS_PER_S
            text = (
                f"{stage.spec.stage} picked {timed(off_s)}, {picking.within}, and "
                f"{picking.stage} took none"
            )
            if abs(off_s) <= picking.tolerance_s:
                return PickReason("dropped", text)
            if picking.is_chance(stage, row, abs(off_s)):
                continue
            return PickReason("late" if off_s > 0 else "early", text)
    near = _near(source, channel, time_ns, reach)
    if not len(near):
        return PickReason(*silent(picking.evidence, source, number, time_ns, reach))
    row = min(near.tolist(), key=lambda r: abs(int(source.candidates.time_ns[r]) - time_ns))
    off_s = (int(source.candidates.time_ns[row]) - time_ns) / NS_PER_S
    often = chance(picking.by_chance(source, row, abs(off_s)))
    reason = _beside(picking, source, row, time_ns)
    text = (
        f"no candidate of its own: the nearest comes {timed(off_s)}, as near and strong a one by "
        f"chance {100 * often:.2g} % of the time: {reason.text}"
    )
    return PickReason("quiet", text, reason.readings)


def late(picking: Picking, channel: str, time_ns: int, picked: Pick) -> PickReason:
    """Say why the arrival itself was not picked but something after it.

    The parameters are those of :func:`missed`; ``picked`` is what answers it.
    """
    part = picking.of(picked)
    late_s = (picked.time_ns - time_ns) / NS_PER_S
    latency_text = f"found {timed(late_s)}, {picking.within}"
    rejected = _rejected(picking, part, channel, time_ns)
    value = _value_at(part, channel, picked.time_ns)
    if rejected is None:
        at = f"within {picking.tolerance_s * 1e3:g} ms of the arrival"
        text = f"{latency_text}: {picking.stage} has no candidate {at}, but a later one{value}"
        return PickReason("late", text)
    if rejected.cause != "threshold":
        return PickReason(rejected.cause, f"{latency_text}: {rejected.text}", rejected.readings)
    text = f"{latency_text}: {rejected.text}; a later one was picked{value}"
    return PickReason("threshold", text, rejected.readings)


def early(picking: Picking, time_ns: int, picked: Pick) -> PickReason:
    """Say by how much something before the arrival passed the gates."""
    passed = false(picking, picked)
    off_s = (picked.time_ns - time_ns) / NS_PER_S
    text = f"found {timed(off_s)}, {picking.within}: a rise before the arrival: {passed.text}"
    return PickReason("early", text, passed.readings)


def false(picking: Picking, picked: Pick) -> PickReason:
    """Say which gate a pick passed by the smallest margin, relative to its threshold."""
    part = picking.of(picked)
    rows = _near(part, picked.channel, picked.time_ns, 0)
    gate_readings = readings(part, int(rows[0])) if len(rows) else ()
    finite = [r for r in gate_readings if np.isfinite(r.margin)]
    gate = min(finite, key=lambda r: r.margin / max(abs(r.threshold), 1e-9), default=None)
    if gate is None:
        return PickReason("false", "it passed every gate", gate_readings)
    sign = "over" if gate.value >= gate.threshold else "under"
    unit = unit_after(gate.unit)
    measured, threshold = readable(gate.value), readable(gate.threshold)
    text = f"{gate.gate} {measured}{unit} {sign} {threshold}{unit} let it pass"
    return PickReason("false", text, gate_readings)


def _rejected(
    picking: Picking, part: StageEvidence, channel: str, time_ns: int
) -> PickReason | None:
    """Say which gate rejected the candidate at an arrival; None where there is no such."""
    for stage in (part, *picking.before(part)):
        near = _near(stage, channel, time_ns, round(picking.tolerance_s * NS_PER_S))
        rejected = [int(r) for r in near if not stage.accepted[r]]
        if rejected:
            return _gate(stage, min(rejected, key=lambda r: closeness(stage, r, time_ns)), time_ns)
    return None


def _gate(part: StageEvidence, row: int, time_ns: int) -> PickReason:
    """Say which gate a candidate failed first, and how far from the arrival it is."""
    gate_readings = readings(part, row)
    first = next(r for r in gate_readings if not r.passed)
    off_s = (int(part.candidates.time_ns[row]) - time_ns) / NS_PER_S
    if first.gate != "refractory":
        return PickReason(
            "threshold", f"the candidate {timed(off_s)} failed {below(first)}", gate_readings
        )
    text = (
        f"the candidate {timed(off_s)} is held off by the pick {first.value * 1e3:.0f} ms earlier "
        f"(refractory {first.threshold * 1e3:.0f} ms)"
    )
    return PickReason("refractory", text, gate_readings)


def _beside(picking: Picking, part: StageEvidence, row: int, time_ns: int) -> PickReason:
    """Say what became of a candidate that is none of the arrival."""
    if not part.accepted[row]:
        return _gate(part, row, time_ns)
    off_s = (int(part.candidates.time_ns[row]) - time_ns) / NS_PER_S
    text = f"the candidate {timed(off_s)} passed every gate, and {picking.stage} did not take it"
    return PickReason("quiet", text, readings(part, row))


def _near(part: StageEvidence, channel: str, time_ns: int, reach: int) -> NDArray[np.intp]:
    """Return the candidates of a channel about a time."""
    rows = part.between(time_ns - reach, time_ns + reach)
    channel_rows: NDArray[np.intp] = rows[
        part.candidates.channel[rows] == part.spec.channels.index(channel)
    ]
    return channel_rows


def _value_at(part: StageEvidence, channel: str, time_ns: int) -> str:
    """Return what a pick reached, as a phrase."""
    rows = _near(part, channel, time_ns, 0)
    if not len(rows):
        return ""
    return f" ({part.spec.columns[0].name} {readable(float(part.candidates.value[rows[0], 0]), 3)})"


@dataclass(frozen=True, slots=True)
class BadPick:
    """A pick that is not where it should be, or is not there.

    Attributes
    ----------
    pick
        Its number in the order of time, from 1.
    time_s
        Of the true arrival; of a false pick its own [s since the first sample].
    channel
        Its channel.
    state
        ``late``, ``early``, ``missed`` or ``false``.
    off_ms
        Pick minus arrival [ms]; NaN of one missed or false.
    reason
        Why.
    """

    pick: int
    time_s: float
    channel: str
    state: str
    off_ms: float
    reason: PickReason


@dataclass(frozen=True, slots=True)
class PickAccount:
    """All picks of a result.

    Attributes
    ----------
    recording, stage
        File name, and the stage that picked.
    tolerance_ms
        Largest error of a right pick [ms].
    counts
        How many are right, late, early, missed and false.
    causes
        How many bad picks have each cause.
    channels
        The same by channel.
    bad
        In the order of time.
    """

    recording: str
    stage: str
    tolerance_ms: float
    counts: PickCounts
    causes: dict[str, int]
    channels: tuple[ChannelPicks, ...]
    bad: tuple[BadPick, ...]


def pick_account(evidence: Evidence, tolerance_s: float = RIGHT_S, stage: str = "") -> PickAccount:
    """Explain every bad pick of one stage.

    Parameters
    ----------
    evidence
        What was stored.
    tolerance_s
        Largest error of a right pick [s].
    stage
        The stage that picks; empty stands for the last one that picks onsets. An array method
        behind it mends picks by each other, and has no reasons of its own why one is late.

    Raises
    ------
    RecordingError
        Where nothing was picked, no such stage picked, or there are no true arrivals.
    """
    picking = _picking(evidence, stage, tolerance_s)
    if not any(x.kind == "pick" for x in evidence.labels):
        raise RecordingError(
            f"{evidence.name}: expected true picks (in the recording, or --truth FILE), found "
            f"none; --kind fixes judges arrivals without them"
        )
    answers = pick_residuals(evidence.labels, picking.picks())
    states = answers.states(tolerance_s)
    bad = [*_bad(picking, answers, states), *_unasked(picking, answers)]
    bad.sort(key=lambda item: (item[0], item[1]))
    numbered = tuple(
        BadPick(number, (time_ns - evidence.start_ns) / NS_PER_S, channel, state, off, reason)
        for number, (time_ns, channel, state, off, reason) in enumerate(bad, 1)
    )
    extra = [item.state for item in numbered if item.state == "false"]
    return PickAccount(
        evidence.name,
        picking.stage,
        tolerance_s * 1e3,
        PickCounts.of(states + extra),
        dict(Counter(item.reason.cause for item in numbered)),
        by_channel(answers.truth, states, answers.error_s, numbered, tolerance_s),
        numbered,
    )


@dataclass(frozen=True, slots=True)
class PickMoment:
    """The candidates for picks at a moment.

    Attributes
    ----------
    time_s
        The moment [s since the first sample].
    bad
        The bad pick that it is about, or None.
    chain
        The candidates around it: of that pick's channel, or of all.
    """

    time_s: float
    bad: BadPick | None
    chain: tuple[Chain, ...]


def pick_moment(
    evidence: Evidence, time_ns: int, bad: BadPick | None, stage: str = ""
) -> PickMoment:
    """Say what the picking stage had at a moment; needs no truth."""
    reach = round(ANSWER_S * NS_PER_S)
    chain = [
        link
        for part in _picking(evidence, stage).parts
        for link in links(evidence, part, time_ns - reach, time_ns + reach)
    ]
    channel_links = tuple(link for link in chain if bad is None or link.channel == bad.channel)
    return PickMoment((time_ns - evidence.start_ns) / NS_PER_S, bad, channel_links)


def bad_picks(evidence: Evidence) -> int | None:
    """Return how many picks are late, early or missed; None without true arrivals or picks."""
    if not any(x.kind == "pick" for x in evidence.labels) or not _picking_parts(evidence):
        return None
    answers = pick_residuals(evidence.labels, _picking(evidence).picks())
    return sum(state != "right" for state in answers.states(RIGHT_S))


def _picking_parts(evidence: Evidence) -> list[StageEvidence]:
    return [part for part in evidence.stages if part.spec.emits == "pick"]


def _picking(evidence: Evidence, stage: str = "", tolerance_s: float = RIGHT_S) -> Picking:
    """Return a stage that picks, or the last for onsets, on all of its topics."""
    parts = _picking_parts(evidence)
    if not parts:
        raise RecordingError(f"{evidence.name}: expected a stage that picks, found none")
    wanted = stage or onsets_of(evidence, parts[-1]).spec.stage
    stage_parts = tuple(part for part in parts if part.spec.stage == wanted)
    if not stage_parts:
        names = ", ".join(dict.fromkeys(part.spec.stage for part in parts))
        raise RecordingError(f"{evidence.name}: expected one of {names}, found {stage}")
    return Picking(evidence, stage_parts, tolerance_s)


_Item = tuple[int, str, str, float, PickReason]


def _bad(picking: Picking, answers: PickResiduals, states: list[str]) -> list[_Item]:
    """Return the true arrivals that were picked late, early or not at all."""
    constant = steady(answers.truth, answers.error_s, picking.tolerance_s)
    items: list[_Item] = []
    for label, state, error, pick in zip(
        answers.truth, states, answers.error_s.tolist(), answers.picks, strict=True
    ):
        if state == "right":
            continue
        reason = _reason(picking, label, state, pick)
        steady_error = constant.get(label.channel)
        if steady_error is not None and abs(error - steady_error.offset_s) <= picking.tolerance_s:
            reason = PickReason(steady_error.cause, f"{label.channel} is {steady_error.text}")
        off_ms = error * 1e3 if state != "missed" else float("nan")
        items.append((label.time_ns, label.channel, state, off_ms, reason))
    return items


def _reason(picking: Picking, label: Label, state: str, pick: Pick | None) -> PickReason:
    if pick is None or state == "missed":
        return missed(picking, label.channel, label.time_ns, pick)
    if state == "late":
        return late(picking, label.channel, label.time_ns, pick)
    return early(picking, label.time_ns, pick)


def _unasked(picking: Picking, answers: PickResiduals) -> list[_Item]:
    """Return the picks near true arrivals of their channel that answer none of them."""
    asked = {(p.topic, p.channel, p.time_ns) for p in answers.picks if p is not None}
    spans: dict[str, tuple[int, int]] = {}
    for label in answers.truth:
        low, high = spans.get(label.channel, (label.time_ns, label.time_ns))
        spans[label.channel] = (min(low, label.time_ns), max(high, label.time_ns))
    items: list[_Item] = []
    for pick in picking.picks():
        low, high = spans.get(pick.channel, (0, -1))
        if low <= pick.time_ns <= high and (pick.topic, pick.channel, pick.time_ns) not in asked:
            reason = false(picking, pick)
            items.append((pick.time_ns, pick.channel, "false", float("nan"), reason))
    return items
