"""The account of sensors that are wrong all through a recording, with what mending them does."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from .place_causes import stands
from .place_remedies import Figures, figures, mending
from .readings import timed
from .swaps import swapped

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from .place_causes import PlaceJudge
    from .place_remedies import PlaceHealer
    from .sensors import Fault

#: A channel without an arrival in this part of the steps is worth a line; so many steps say why.
SILENT_PART, SILENT_SAMPLE = 0.5, 20


@dataclass(frozen=True, slots=True)
class SensorFault:
    """A sensor that is wrong all through a recording.

    Attributes
    ----------
    channel
        Its channel.
    cause
        ``clock``, ``position``, ``unclear`` which of these two, or why it has no arrivals:
        ``dead``, ``clipped``, ``threshold``...
    text
        The same for people.
    steps
        In how many steps.
    offset_ms
        By how much it is late (< 0: early) [ms]; NaN where that is not what it is.
    x_m, y_m, stated_x_m, stated_y_m
        Where it seems to stand, and where the geometry has it [m].
    before_ms, after_ms
        Median distance from the arrival curve of the others, as it is and mended [ms].
    gain
        By how much the cause explains its arrivals better than none (BIC); NaN where it has none.
    rival, rival_gain
        The other cause that was tried, and by how much that does.
    change
        What mends it; empty where nothing does.
    before, after
        All places as they are and mended; None where nothing does.
    """

    channel: str
    cause: str
    text: str
    steps: int
    offset_ms: float
    x_m: float
    y_m: float
    stated_x_m: float
    stated_y_m: float
    before_ms: float
    after_ms: float
    gain: float
    rival: str
    rival_gain: float
    change: str
    before: Figures | None
    after: Figures | None


def faulty_sensors(healer: PlaceHealer, faults: Sequence[Fault]) -> tuple[SensorFault, ...]:
    """Return the accounts of sensors that are late or displaced.

    Two that are swapped are mended together. A change that does harm to the places is not offered.
    """
    by_channel = {fault.channel: fault for fault in faults}
    accounts = {fault.channel: _faulty(healer, fault) for fault in faults}
    names = healer.relocator.names
    for pair in swapped(faults, healer.relocator.positions):
        both = healer.without_faults(tuple(by_channel[channel] for channel in pair))
        after = figures(both, healer.reference, healer.tolerance_m)
        for one, other in (pair, pair[::-1]):
            text = f"{accounts[one].text}: swapped with {names[other]}"
            accounts[one] = replace(accounts[one], text=text, after=after)
    return tuple(
        replace(account, change="") if healer.before.harmed_by(account.after) else account
        for account in accounts.values()
        if account.after is not None
    )


def _faulty(healer: PlaceHealer, fault: Fault) -> SensorFault:
    positions = healer.relocator.positions
    (x, y), (x0, y0) = fault.place.tolist(), positions[fault.channel].tolist()
    clock = fault.cause == "clock"
    steady = f"{timed(fault.offset_s)} in {fault.steps} steps, the median"
    text = steady if clock else stands(fault, positions)
    return SensorFault(
        channel=healer.relocator.names[fault.channel],
        cause=fault.cause if fault.clear else "unclear",
        text=text if fault.clear else f"late or displaced: {text}, or the other",
        steps=fault.steps,
        offset_ms=fault.offset_s * 1e3 if clock else float("nan"),
        x_m=x,
        y_m=y,
        stated_x_m=x0,
        stated_y_m=y0,
        before_ms=fault.before_s * 1e3,
        after_ms=fault.after_s * 1e3,
        gain=fault.gain,
        rival="position" if clock else "clock",
        rival_gain=fault.rival_gain,
        change=mending(fault, healer.relocator),
        before=healer.before,
        after=figures(healer.without_faults((fault,)), healer.reference, healer.tolerance_m),
    )


def silent_sensors(judge: PlaceJudge) -> tuple[SensorFault, ...]:
    """Return the accounts of sensors that have no arrival in most steps."""
    lacking = np.isnan(judge.relocator.arrivals.times_s)
    if not len(lacking):
        return ()
    silent = np.flatnonzero(lacking.mean(axis=0) >= SILENT_PART)
    return tuple(_silent(judge, int(c), np.flatnonzero(lacking[:, c])) for c in silent)


def _silent(judge: PlaceJudge, channel: int, rows: NDArray[np.intp]) -> SensorFault:
    """Say why a sensor is silent, by the most frequent cause in some of the steps."""
    name = judge.relocator.names[channel]
    sample = rows[:: max(1, len(rows) // SILENT_SAMPLE)]
    missing = [m for row in sample for m in judge.missing(int(row)) if m.channel == name]
    cause = Counter(m.cause for m in missing).most_common(1)[0][0] if missing else "taken"
    why = next((m.text for m in missing if m.cause == cause), "its picks belong to other steps")
    count, nan = len(judge.relocator.arrivals.step_ns), float("nan")
    x, y = judge.relocator.positions[channel].tolist()
    text = f"no arrival in {len(rows)} of {count} steps: {why}"
    return SensorFault(
        channel=name,
        cause=cause,
        text=text,
        steps=len(rows),
        offset_ms=nan,
        x_m=nan,
        y_m=nan,
        stated_x_m=x,
        stated_y_m=y,
        before_ms=nan,
        after_ms=nan,
        gain=nan,
        rival="",
        rival_gain=nan,
        change="",
        before=None,
        after=None,
    )
