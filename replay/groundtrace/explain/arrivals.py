"""The account of picks: late, early, missed and false ones, channel by channel, with the reason.

Against true arrivals. Where truth has none, the arrivals of a step are judged by each other, as
part of its place: see :mod:`.places`.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from ..errors import RecordingError
from ..score.picks import ANSWER_S, pick_residuals
from .candidates import Chain, links
from .parts import accepted_picks, onsets_of
from .pick_channels import ChannelPicks, PickCounts, by_channel, clocks
from .pick_reasons import PickReason, early, false, late, missed
from .readings import timed

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from groundtrace_codecs.labels import Label

    from .evidence import Evidence, StageEvidence

    Array = NDArray[np.float64]


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


def pick_account(evidence: Evidence, tolerance_s: float = 0.002, stage: str = "") -> PickAccount:
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
    part = _picking(evidence, stage)
    truth = sorted(x for x in evidence.labels if x.kind == "pick")
    if not truth:
        raise RecordingError(
            f"{evidence.name}: expected true picks (in the recording, or --truth FILE), found "
            f"none; --kind fixes judges arrivals without them"
        )
    errors_s = pick_residuals(evidence.labels, accepted_picks(part)).error_s
    states = [_state(float(error), tolerance_s) for error in errors_s]
    bad = _bad(evidence, part, truth, errors_s, tolerance_s)
    bad += _unasked(part, truth, errors_s)
    bad.sort(key=lambda item: (item[0], item[1]))
    numbered = tuple(
        BadPick(number, (time_ns - evidence.start_ns) / NS_PER_S, channel, state, off, reason)
        for number, (time_ns, channel, state, off, reason) in enumerate(bad, 1)
    )
    extra = [item.state for item in numbered if item.state == "false"]
    return PickAccount(
        evidence.name,
        part.spec.stage,
        tolerance_s * 1e3,
        PickCounts.of(states + extra),
        dict(Counter(item.reason.cause for item in numbered)),
        by_channel(truth, states, errors_s, numbered, tolerance_s),
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
    chain = links(evidence, _picking(evidence, stage), time_ns - reach, time_ns + reach)
    kept = tuple(link for link in chain if bad is None or link.channel == bad.channel)
    return PickMoment((time_ns - evidence.start_ns) / NS_PER_S, bad, kept)


def bad_picks(evidence: Evidence, tolerance_s: float = 0.002) -> int | None:
    """Return how many picks are late, early or missed; None without true arrivals or picks."""
    if not any(x.kind == "pick" for x in evidence.labels) or not _picking_parts(evidence):
        return None
    errors_s = pick_residuals(evidence.labels, accepted_picks(_picking(evidence))).error_s
    return sum(_state(float(error), tolerance_s) != "right" for error in errors_s)


def _picking_parts(evidence: Evidence) -> list[StageEvidence]:
    return [part for part in evidence.stages if part.spec.emits == "pick"]


def _picking(evidence: Evidence, stage: str = "") -> StageEvidence:
    """Return a stage that picks, or the last for onsets; of its topics the one with most to say."""
    parts = _picking_parts(evidence)
    if not parts:
        raise RecordingError(f"{evidence.name}: expected a stage that picks, found none")
    wanted = stage or onsets_of(evidence, parts[-1]).spec.stage
    found = [part for part in parts if part.spec.stage == wanted]
    if not found:
        names = ", ".join(dict.fromkeys(part.spec.stage for part in parts))
        raise RecordingError(f"{evidence.name}: expected one of {names}, found {stage}")
    return max(found, key=lambda part: len(part.candidates))


def _state(error_s: float, tolerance_s: float) -> str:
    if not abs(error_s) <= ANSWER_S:
        return "early" if error_s < -ANSWER_S else "missed"
    if abs(error_s) <= tolerance_s:
        return "right"
    return "late" if error_s > 0 else "early"


_Item = tuple[int, str, str, float, PickReason]


def _bad(
    evidence: Evidence,
    part: StageEvidence,
    truth: list[Label],
    errors_s: Array,
    tolerance_s: float,
) -> list[_Item]:
    """Return the true arrivals that were picked late, early or not at all."""
    found: list[_Item] = []
    steady = clocks(truth, errors_s, tolerance_s)
    for label, error in zip(truth, errors_s.tolist(), strict=True):
        state = _state(error, tolerance_s)
        if state == "right":
            continue
        if state == "missed" or label.channel not in part.spec.channels:
            reason = missed(evidence, part, label.channel, label.time_ns, tolerance_s)
            found.append((label.time_ns, label.channel, "missed", float("nan"), reason))
            continue
        picked_ns = label.time_ns + round(error * NS_PER_S)
        usual_s = steady.get(label.channel)
        if usual_s is not None and abs(error - usual_s) <= abs(usual_s) / 2:
            reason = PickReason("clock", f"{label.channel} is {timed(usual_s)} all the time")
        elif state == "late":
            reason = late(evidence, part, label.channel, label.time_ns, picked_ns, tolerance_s)
        else:
            reason = early(part, label.channel, picked_ns)
        found.append((label.time_ns, label.channel, state, error * 1e3, reason))
    return found


def _unasked(part: StageEvidence, truth: list[Label], errors_s: Array) -> list[_Item]:
    """Return the picks near true arrivals of their channel that answer none of them."""
    answers = {
        (label.channel, label.time_ns + round(error * NS_PER_S))
        for label, error in zip(truth, errors_s.tolist(), strict=True)
        if np.isfinite(error)
    }
    spans: dict[str, tuple[int, int]] = {}
    for label in truth:
        low, high = spans.get(label.channel, (label.time_ns, label.time_ns))
        spans[label.channel] = (min(low, label.time_ns), max(high, label.time_ns))
    found: list[_Item] = []
    for pick in accepted_picks(part):
        low, high = spans.get(pick.channel, (0, -1))
        inside = low <= pick.time_ns <= high
        if inside and not _answers(answers, pick.channel, pick.time_ns):
            reason = false(part, pick.channel, pick.time_ns)
            found.append((pick.time_ns, pick.channel, "false", float("nan"), reason))
    return found


def _answers(answers: set[tuple[str, int]], channel: str, time_ns: int) -> bool:
    """Whether a pick is an answer; the error in seconds may have been rounded by 1 ns."""
    return any((channel, time_ns + k) in answers for k in (-1, 0, 1))
