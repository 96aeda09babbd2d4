"""Reasons of bad picks, in the words of the stage that picked."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from .readings import below, closeness, readings, timed
from .reasons import channel_verdict
from .silence import silence

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .evidence import Evidence, StageEvidence
    from .readings import GateReading

#: A channel without a pick is looked at so long about the arrival [s].
REACH_S = 0.05


@dataclass(frozen=True, slots=True)
class PickReason:
    """Why a pick is bad: one word, the same for people, and the gates of what was decided there."""

    cause: str
    text: str
    readings: tuple[GateReading, ...] = ()


def missed(
    evidence: Evidence, part: StageEvidence, channel: str, time_ns: int, tolerance_s: float
) -> PickReason:
    """Say why an arrival was not picked: its gates, a dead, clipped or quiet channel.

    Parameters
    ----------
    evidence, part
        The result, and the stage that picked.
    channel, time_ns
        Of the true arrival.
    tolerance_s
        Largest error of a right pick [s].
    """
    if channel not in part.spec.channels:
        return PickReason("gap", "the channel is not in the recording")
    rejected = _rejected(part, channel, time_ns, tolerance_s)
    if rejected is not None:
        return rejected
    number, reach = part.spec.channels.index(channel), round(REACH_S * NS_PER_S)
    source = _traced(evidence, part)
    rows = source.between(time_ns - reach, time_ns + reach)
    cause, text = channel_verdict(source, rows, number, time_ns, reach)
    picked = [r for r in _near(part, channel, time_ns, reach) if part.accepted[r]]
    if cause == "taken" and picked:
        off_ns = min((int(part.candidates.time_ns[r]) - time_ns for r in picked), key=abs)
        text = f"picked {timed(off_ns / NS_PER_S)} instead: that pick does not count for this step"
    return PickReason(cause, text)


def late(
    evidence: Evidence,
    part: StageEvidence,
    channel: str,
    time_ns: int,
    picked_ns: int,
    tolerance_s: float,
) -> PickReason:
    """Say why the arrival itself was not picked but something after it, at ``picked_ns``.

    The other parameters are those of :func:`missed`.
    """
    found = _rejected(part, channel, time_ns, tolerance_s)
    if found is None:
        return _unseen(evidence, part, channel, time_ns, picked_ns)
    if found.cause != "threshold":
        return found
    phase = _value_at(part, channel, picked_ns)
    text = f"the first swing is under the threshold: {found.text}; picked the later phase{phase}"
    return PickReason("threshold", text, found.readings)


def _rejected(
    part: StageEvidence, channel: str, time_ns: int, tolerance_s: float
) -> PickReason | None:
    """Say which gate rejected the candidate at an arrival; None where there is no such."""
    reach = round(tolerance_s * NS_PER_S)
    own = [r for r in _near(part, channel, time_ns, reach) if not part.accepted[r]]
    if not own:
        return None
    told = readings(part, int(min(own, key=lambda r: closeness(part, int(r), time_ns))))
    first = next(r for r in told if not r.passed)
    if first.gate != "refractory":
        return PickReason("threshold", below(first), told)
    text = (
        f"held off by the pick {first.value * 1e3:.0f} ms earlier "
        f"(refractory {first.threshold * 1e3:.0f} ms)"
    )
    return PickReason("refractory", text, told)


def early(part: StageEvidence, channel: str, picked_ns: int) -> PickReason:
    """Say by how much something before the arrival passed the gates."""
    passed = false(part, channel, picked_ns)
    return PickReason("early", f"a rise before the arrival: {passed.text}", passed.readings)


def false(part: StageEvidence, channel: str, time_ns: int) -> PickReason:
    """Say which gate a pick passed by the smallest margin, relative to its threshold."""
    own = _near(part, channel, time_ns, 1)
    told = readings(part, int(own[0])) if len(own) else ()
    finite = [r for r in told if np.isfinite(r.margin)]
    gate = min(finite, key=lambda r: r.margin / max(abs(r.threshold), 1e-9), default=None)
    if gate is None:
        return PickReason("false", "it passed every gate", told)
    sign = "over" if gate.value >= gate.threshold else "under"
    text = f"{gate.gate} {gate.value:.4g} {sign} {gate.threshold:.4g} let it pass"
    return PickReason("false", text, told)


def _near(part: StageEvidence, channel: str, time_ns: int, reach: int) -> NDArray[np.intp]:
    """Return the candidates of a channel about a time."""
    rows = part.between(time_ns - reach, time_ns + reach)
    own: NDArray[np.intp] = rows[part.candidates.channel[rows] == part.spec.channels.index(channel)]
    return own


def _unseen(
    evidence: Evidence, part: StageEvidence, channel: str, time_ns: int, picked_ns: int
) -> PickReason:
    """Say what there is where the arrival left no candidate at all."""
    source = _traced(evidence, part)
    reach = round(REACH_S * NS_PER_S)
    number = source.spec.channels.index(channel)
    quiet = silence(source, number, time_ns - reach, time_ns)
    if quiet.cause in ("dead", "clipped"):
        return PickReason(quiet.cause, quiet.text)
    off_ms = (picked_ns - time_ns) / 1e6
    text = (
        f"no candidate of its own at the arrival: the onset was put {off_ms:.1f} ms later"
        f"{_value_at(part, channel, picked_ns)}"
    )
    return PickReason("onset", text)


def _value_at(part: StageEvidence, channel: str, time_ns: int) -> str:
    """Return what a pick reached, as a phrase."""
    own = _near(part, channel, time_ns, 1)
    if not len(own):
        return ""
    return f" ({part.spec.columns[0].name} {float(part.candidates.value[own[0], 0]):.3g})"


def _traced(evidence: Evidence, part: StageEvidence) -> StageEvidence:
    """Return the last stage with a trace that picks on the same topic, up to a stage."""
    order = [stage.key for stage in evidence.config.stage]
    upto = order[: order.index(part.spec.stage) + 1]
    found = [
        e
        for key in upto
        for e in evidence.of(key)
        if e.spec.emits == "pick" and e.spec.topic == part.spec.topic and e.spec.trace
    ]
    return found[-1] if found else part
