"""Reasons of bad picks, in the words of the stage that picked.

Time comes first: a pick near an arrival that does not answer it is late or early by so much, and
only where there is none a gate, a filter or a silent channel is looked for.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from ..score.picks import ANSWER_S
from .parts import accepted_picks
from .readings import below, closeness, readings, timed
from .reasons import silent, without_filter
from .silence import FRAME_NS, silence
from .unfiltered import passes_levels

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from groundtrace_codecs.events import Pick

    from .evidence import Evidence, StageEvidence
    from .readings import GateReading

#: A candidate beside an arrival is of it where chance brings one as near and as strong less often
#: than so: the usual 5 % of a test.
CHANCE = 0.05
#: The cause of a bad pick, in one word.
PICK_CAUSES = (
    "clock",
    "latency",
    "late",
    "early",
    "threshold",
    "refractory",
    "dropped",
    "dead",
    "clipped",
    "filter",
    "quiet",
    "shape",
    "gap",
    "false",
)


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
        own = [part for part in self.parts if channel in part.spec.channels]
        return next((part for part in own if self._has_signal(part, time_ns)), None)

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
        own = [int(r) for r in rows if not stage.accepted[r]]
        if not own:
            continue
        row = min(own, key=lambda r: abs(int(stage.candidates.time_ns[r]) - time_ns))
        off_s = (int(stage.candidates.time_ns[row]) - time_ns) / NS_PER_S
        if not picking.is_chance(stage, row, abs(off_s)):
            found = _gate(stage, row, time_ns)
            text = f"the nearest candidate comes {timed(off_s)}, {picking.within}: {found.text}"
            return PickReason("late" if off_s > 0 else "early", text, found.readings)
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
    found = signal.nearest(source, number, time_ns - reach, time_ns + reach)
    if measured is None or found is None:
        return None
    off_ns = abs(found.time_ns - time_ns)
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
    told = _beside(picking, source, nearest, time_ns)
    text = f"{without_filter(source, found, time_ns)}; with it {told.text}"
    return PickReason("filter", text, told.readings)


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
    told = _beside(picking, source, row, time_ns)
    text = (
        f"no candidate of its own: the nearest comes {timed(off_s)}, as near and strong a one by "
        f"chance {100 * often:.2g} % of the time: {told.text}"
    )
    return PickReason("quiet", text, told.readings)


def late(picking: Picking, channel: str, time_ns: int, picked: Pick) -> PickReason:
    """Say why the arrival itself was not picked but something after it.

    The parameters are those of :func:`missed`; ``picked`` is what answers it.
    """
    part = picking.of(picked)
    late_s = (picked.time_ns - time_ns) / NS_PER_S
    found = f"found {timed(late_s)}, {picking.within}"
    rejected = _rejected(picking, part, channel, time_ns)
    value = _value_at(part, channel, picked.time_ns)
    if rejected is None:
        at = f"within {picking.tolerance_s * 1e3:g} ms of the arrival"
        text = f"{found}: {picking.stage} has no candidate {at}, but a later one{value}"
        return PickReason("late", text)
    if rejected.cause != "threshold":
        return PickReason(rejected.cause, f"{found}: {rejected.text}", rejected.readings)
    text = f"{found}: {rejected.text}; a later one was picked{value}"
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
    own = _near(part, picked.channel, picked.time_ns, 0)
    told = readings(part, int(own[0])) if len(own) else ()
    finite = [r for r in told if np.isfinite(r.margin)]
    gate = min(finite, key=lambda r: r.margin / max(abs(r.threshold), 1e-9), default=None)
    if gate is None:
        return PickReason("false", "it passed every gate", told)
    sign = "over" if gate.value >= gate.threshold else "under"
    text = f"{gate.gate} {gate.value:.4g} {sign} {gate.threshold:.4g} let it pass"
    return PickReason("false", text, told)


def _rejected(
    picking: Picking, part: StageEvidence, channel: str, time_ns: int
) -> PickReason | None:
    """Say which gate rejected the candidate at an arrival; None where there is no such."""
    for stage in (part, *picking.before(part)):
        near = _near(stage, channel, time_ns, round(picking.tolerance_s * NS_PER_S))
        own = [int(r) for r in near if not stage.accepted[r]]
        if own:
            return _gate(stage, min(own, key=lambda r: closeness(stage, r, time_ns)), time_ns)
    return None


def _gate(part: StageEvidence, row: int, time_ns: int) -> PickReason:
    """Say which gate a candidate failed first, and how far from the arrival it is."""
    told = readings(part, row)
    first = next(r for r in told if not r.passed)
    off_s = (int(part.candidates.time_ns[row]) - time_ns) / NS_PER_S
    if first.gate != "refractory":
        return PickReason("threshold", f"the candidate {timed(off_s)} failed {below(first)}", told)
    text = (
        f"the candidate {timed(off_s)} is held off by the pick {first.value * 1e3:.0f} ms earlier "
        f"(refractory {first.threshold * 1e3:.0f} ms)"
    )
    return PickReason("refractory", text, told)


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
    own: NDArray[np.intp] = rows[part.candidates.channel[rows] == part.spec.channels.index(channel)]
    return own


def _value_at(part: StageEvidence, channel: str, time_ns: int) -> str:
    """Return what a pick reached, as a phrase."""
    own = _near(part, channel, time_ns, 0)
    if not len(own):
        return ""
    return f" ({part.spec.columns[0].name} {float(part.candidates.value[own[0], 0]):.3g})"
