"""The account of picks: late, early, missed and false ones, channel by channel, with the reason.

Against true arrivals. Where truth has none, the arrivals of a step are judged by each other, as
part of its place: see :mod:`.places`.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

from groundtrace_codecs.signals import NS_PER_S

from ..errors import RecordingError
from ..score.picks import ANSWER_S, RIGHT_S, pick_residuals
from .candidates import Chain, links
from .parts import onsets_of
from .pick_channels import ChannelPicks, PickCounts, by_channel, steady
from .pick_reasons import Picking, PickReason, early, false, late, missed

if TYPE_CHECKING:
    from groundtrace_codecs.events import Pick
    from groundtrace_codecs.labels import Label

    from ..score.picks import PickResiduals
    from .evidence import Evidence, StageEvidence


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
    kept = tuple(link for link in chain if bad is None or link.channel == bad.channel)
    return PickMoment((time_ns - evidence.start_ns) / NS_PER_S, bad, kept)


def bad_picks(evidence: Evidence, tolerance_s: float = RIGHT_S) -> int | None:
    """Return how many picks are late, early or missed; None without true arrivals or picks."""
    if not any(x.kind == "pick" for x in evidence.labels) or not _picking_parts(evidence):
        return None
    answers = pick_residuals(evidence.labels, _picking(evidence).picks())
    return sum(state != "right" for state in answers.states(tolerance_s))


def _picking_parts(evidence: Evidence) -> list[StageEvidence]:
    return [part for part in evidence.stages if part.spec.emits == "pick"]


def _picking(evidence: Evidence, stage: str = "", tolerance_s: float = RIGHT_S) -> Picking:
    """Return a stage that picks, or the last for onsets, on all of its topics."""
    parts = _picking_parts(evidence)
    if not parts:
        raise RecordingError(f"{evidence.name}: expected a stage that picks, found none")
    wanted = stage or onsets_of(evidence, parts[-1]).spec.stage
    found = tuple(part for part in parts if part.spec.stage == wanted)
    if not found:
        names = ", ".join(dict.fromkeys(part.spec.stage for part in parts))
        raise RecordingError(f"{evidence.name}: expected one of {names}, found {stage}")
    return Picking(evidence, found, tolerance_s)


_Item = tuple[int, str, str, float, PickReason]


def _bad(picking: Picking, answers: PickResiduals, states: list[str]) -> list[_Item]:
    """Return the true arrivals that were picked late, early or not at all."""
    constant = steady(answers.truth, answers.error_s, picking.tolerance_s)
    found: list[_Item] = []
    for label, state, error, pick in zip(
        answers.truth, states, answers.error_s.tolist(), answers.picks, strict=True
    ):
        if state == "right":
            continue
        reason = _reason(picking, label, state, pick)
        usual = constant.get(label.channel)
        if usual is not None and abs(error - usual.offset_s) <= picking.tolerance_s:
            reason = PickReason(usual.cause, f"{label.channel} is {usual.text}")
        off_ms = error * 1e3 if state != "missed" else float("nan")
        found.append((label.time_ns, label.channel, state, off_ms, reason))
    return found


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
    found: list[_Item] = []
    for pick in picking.picks():
        low, high = spans.get(pick.channel, (0, -1))
        if low <= pick.time_ns <= high and (pick.topic, pick.channel, pick.time_ns) not in asked:
            reason = false(picking, pick)
            found.append((pick.time_ns, pick.channel, "false", float("nan"), reason))
    return found
