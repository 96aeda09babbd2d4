"""Why a vehicle was missed, or reported where there was none: the gates of its passes or course."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.events import readable, unit_after
from groundtrace_codecs.signals import NS_PER_S

from ..dsp.assignment import assign
from ..errors import RecordingError
from ..evaluation.vehicles import PASS_TOLERANCE_S
from .reasons import Chain, below, closeness, links, readings

if TYPE_CHECKING:
    from collections.abc import Sequence

    from groundtrace_codecs.events import Label

    from ..pipeline.results import Evidence, StageEvidence

#: Candidates of a course lie within this of the vehicle's first and last pass [s]. Chosen by
#: judgement: stations lie within 100 m, and vehicles drive at 10 m/s and faster.
_COURSE_S = 10.0
#: By this part of a value a remedy lies beyond it. Chosen by judgement: more than its six digits
#: and a float of 32 bits leave open.
_BEYOND = 1e-4
#: And those that tell why there is none at a station [s]. Chosen by judgement: three tolerances of
#: a pass.
_ABOUT_S = 3.0


@dataclass(frozen=True, slots=True)
class VehicleReason:
    """One pass or course that is not right.

    Attributes
    ----------
    state
        ``missed`` or ``false``.
    time_s
        The true pass, or the false one [s since the first sample].
    target
        The vehicle; empty for a false one.
    station
        Where; ``all`` for a course.
    stage
        The stage whose gates say why.
    text
        Why.
    change
        The setting of one gate that alone would mend it; empty where there is none. What it does
        to others is for ``sweep`` to tell; of a false one the text says how many right ones it
        costs.
    """

    state: str
    time_s: float
    target: str
    station: str
    stage: str
    text: str
    change: str


@dataclass(frozen=True, slots=True)
class VehicleAccount:
    """All passes or courses of a result that are not right.

    Attributes
    ----------
    recording, stage
        File name, and the stage looked at: the last one that tells passes, else tracks.
    right, missed, false
        How many passes at stations, or courses.
    reasons
        In the order of time.
    """

    recording: str
    stage: str
    right: int
    missed: int
    false: int
    reasons: tuple[VehicleReason, ...]


@dataclass(frozen=True, slots=True)
class VehicleMoment:
    """The candidates of all stages about a moment [s since the first sample]."""

    time_s: float
    chain: tuple[Chain, ...]


@dataclass(frozen=True, slots=True)
class _True:
    """What truth has: a span of time [ns] at a station, or at all."""

    start_ns: int
    end_ns: int
    target: str
    station: str


def vehicle_account(evidence: Evidence) -> VehicleAccount:
    """Explain all passes, or courses where the pipeline tells no passes.

    Raises
    ------
    RecordingError
        Where there is no truth of passes, or no stage that tells passes or tracks.
    """
    part = _telling(evidence)
    truth = _truth(evidence.labels, each_station=part.spec.emits == "pass")
    if not truth:
        raise RecordingError(
            f"{evidence.name}: expected true passes (in the recording, or --truth FILE), found "
            f"none; --at SECONDS explains a moment without truth"
        )
    rows = np.flatnonzero(part.accepted)
    pairs = _matched(part, truth, rows)
    missed = [_missed(evidence, part, truth[i]) for i in set(range(len(truth))) - set(pairs)]
    right = sorted(pairs.values())
    false = [_false(evidence, part, int(row), right) for row in set(rows) - set(right)]
    reasons = sorted([*missed, *false], key=lambda r: (r.time_s, r.station))
    counts = len(pairs), len(missed), len(false)
    return VehicleAccount(evidence.name, part.spec.stage, *counts, tuple(reasons))


def vehicle_moment(evidence: Evidence, time_ns: int) -> VehicleMoment:
    """Return the cycle that hears vehicles at a moment, and what is near of the later stages."""
    chain: list[Chain] = []
    for part in evidence.stages:
        near_ns = round(0.25 * NS_PER_S if part.spec.emits == "presence" else 2 * NS_PER_S)
        if part.spec.emits == "track":
            near_ns = round(_COURSE_S * NS_PER_S)
        chain += links(evidence, part, time_ns - near_ns, time_ns + near_ns)
    return VehicleMoment((time_ns - evidence.start_ns) / NS_PER_S, tuple(chain))


def _telling(evidence: Evidence) -> StageEvidence:
    for emits in ("pass", "track"):
        parts = [part for part in evidence.stages if part.spec.emits == emits]
        if parts:
            return parts[-1]
    raise RecordingError(
        f"{evidence.name}: --kind vehicles: expected a stage that tells passes or tracks, found "
        f"none"
    )


def _truth(labels: Sequence[Label], *, each_station: bool) -> list[_True]:
    passes = sorted((x for x in labels if x.kind == "pass"), key=lambda x: (x.time_ns, x.channel))
    if each_station:
        near_ns = round(PASS_TOLERANCE_S * NS_PER_S)
        return [
            _True(x.time_ns - near_ns, x.time_ns + near_ns, x.target, x.channel) for x in passes
        ]
    far_ns = round(_COURSE_S * NS_PER_S)
    spans = []
    for target in dict.fromkeys(x.target for x in passes):
        times = [x.time_ns for x in passes if x.target == target]
        spans.append(_True(min(times) - far_ns, max(times) + far_ns, target, "all"))
    return spans


def _matched(part: StageEvidence, truth: list[_True], rows: np.ndarray) -> dict[int, int]:
    """Return which accepted row answers which true one."""
    if not len(rows):
        return {}
    cost = np.full((len(truth), len(rows)), np.inf)
    for i, one in enumerate(truth):
        for j, row in enumerate(rows):
            time_ns = int(part.candidates.time_ns[row])
            name = part.spec.channels[int(part.candidates.channel[row])]
            if name == one.station and one.start_ns <= time_ns <= one.end_ns:
                cost[i, j] = abs(time_ns - (one.start_ns + one.end_ns) // 2) / NS_PER_S
    return {int(i): int(rows[j]) for i, j in assign(cost, np.inf)}


def _missed(evidence: Evidence, part: StageEvidence, one: _True) -> VehicleReason:
    middle_ns = (one.start_ns + one.end_ns) // 2
    rows = [
        int(row)
        for row in part.between(one.start_ns, one.end_ns)
        if part.spec.channels[int(part.candidates.channel[row])] == one.station
        and not part.accepted[row]
    ]
    if rows:
        row = min(rows, key=lambda r: closeness(part, r, middle_ns))
        stage, text, change = _rejected(part, row)
    else:
        stage, text, change = _unheard(evidence, one, middle_ns)
    time_s = (middle_ns - evidence.start_ns) / NS_PER_S
    return VehicleReason("missed", time_s, one.target, one.station, stage, text, change)


def _rejected(part: StageEvidence, row: int) -> tuple[str, str, str]:
    failed = [r for r in readings(part, row) if not r.passed]
    text = "; ".join(below(r) for r in failed)
    change = ""
    if len(failed) == 1 and np.isfinite(failed[0].value):
        change = f"{part.spec.stage}.{failed[0].parameter}={failed[0].value:.6g}"
    return part.spec.stage, text, change


def _unheard(evidence: Evidence, one: _True, middle_ns: int) -> tuple[str, str, str]:
    """Say what the stage that hears vehicles has, where nothing came of it."""
    stations = _stations(evidence)
    best: tuple[float, StageEvidence, int] | None = None
    for part in evidence.stages:
        if part.spec.emits != "presence":
            continue
        near_ns = round(_ABOUT_S * NS_PER_S)
        for row in part.between(middle_ns - near_ns, middle_ns + near_ns):
            name = part.spec.channels[int(part.candidates.channel[row])]
            loud = float(part.candidates.value[row, 0])
            if one.station in ("all", stations.get(name, name)) and (
                best is None or loud > best[0]
            ):
                best = loud, part, int(row)
    if best is None:
        return "", "nothing was recorded then", ""
    loud, part, row = best
    loudest_text = f"no candidate; at its loudest {loud:.1f} dB over the noise"
    if part.accepted[row]:
        return (
            part.spec.stage,
            f"{loudest_text}, a vehicle: it does not stand out as one of its own",
            "",
        )
    stage, text, change = _rejected(part, row)
    return stage, f"{loudest_text}: {text}", change


def _false(
    evidence: Evidence, part: StageEvidence, row: int, right: Sequence[int]
) -> VehicleReason:
    """Say which gate alone rejects a false pass or course at the loss of the fewest right ones."""
    margins: dict[str, list[float]] = {r.gate: [] for r in readings(part, row)}
    for other in right:
        for r in readings(part, other):
            margins[r.gate].append(r.margin)
    gates = [r for r in readings(part, row) if np.isfinite(r.value)]
    lost = {r.gate: sum(margin <= r.margin for margin in margins[r.gate]) for r in gates}
    best = min(gates, key=lambda r: (lost[r.gate], r.margin / max(abs(r.threshold), 1e-9)))
    unit = unit_after(best.unit)
    # just beyond what it has, on the side that the margin comes from
    step = np.sign(best.value - best.threshold) or 1.0
    value = best.value + step * max(abs(best.value), 1e-3) * _BEYOND
    change = f"{part.spec.stage}.{best.parameter}={value:.6g}"
    text = (
        f"passed all gates; {best.gate} {readable(best.value)}{unit}, "
        f"threshold {readable(best.threshold)}: "
        f"the setting loses {lost[best.gate]} of {len(right)} right ones"
    )
    time_s = (int(part.candidates.time_ns[row]) - evidence.start_ns) / NS_PER_S
    name = part.spec.channels[int(part.candidates.channel[row])]
    return VehicleReason("false", time_s, "", name, part.spec.stage, text, change)


def _stations(evidence: Evidence) -> dict[str, str]:
    """Return the station of each channel."""
    if evidence.geometry is None:
        return {}
    site = evidence.geometry.stations()
    return {channel: site.names[index] for channel, index in site.of_channel.items()}
