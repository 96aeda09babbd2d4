"""Clocks so far apart that waveforms cannot be compared: onsets tell them first.

Arrivals by correlation are an order finer than onsets, but presume that a delay is one that a wave
can take and turns phases as a wave does. A clock that is off by milliseconds does neither. Onsets
are what they are by any clock: so the clocks are told roughly by them, and with clocks known that
far, finely by correlation, nearer with each replay.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ..errors import RecordingError
from ..localizers.floor import EXPONENT
from .applied import calibrated_geometry
from .arrivals import gather, picking_stages
from .estimate import calibrate

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from groundtrace_codecs.events import Event
    from groundtrace_codecs.geometry import Geometry
    from groundtrace_codecs.labels import Label

    from .estimate import Calibration

#: Most replays more, and the part of an arrival's deviation that settled clocks move by at most.
PASSES, SETTLED = 6, 0.5
AGAIN = (
    "scale, exponent: of onsets, which tell clocks so far apart better than {stage}: left as they "
    "were; replay with the geometry found, then calibrate again"
)


@dataclass(frozen=True, slots=True)
class Choices:
    """What to presume, see :func:`.estimate.calibrate`; ``exponent`` is of the last arrivals."""

    ignore_places: bool = False
    offsets: str = "auto"
    exponent: float = EXPONENT


def calibrate_once(
    events: Sequence[Event], geometry: Geometry, labels: Sequence[Label], choices: Choices
) -> Calibration:
    """Calibrate by the last stage that picks; only the clocks by one before where that is better.

    Parameters
    ----------
    events, labels
        As of :func:`.arrivals.gather`.
    geometry
        Outline and unit of the site.
    choices
        What to presume.

    Raises
    ------
    RecordingError
        As :func:`.arrivals.gather` and :func:`.estimate.calibrate`.
    """
    found = _by_stage(events, geometry, labels, choices)
    stages = picking_stages(events)
    for stage in stages[:-1] if choices.offsets != "no" else ():
        try:
            other = _by_stage(events, geometry, labels, replace(choices, exponent=EXPONENT), stage)
        except RecordingError:
            continue
        if other.offsets_estimated and other.arrival_sigma_s < found.arrival_sigma_s:
            found = _clocks_alone(other, stages[-1])
    return found


def _by_stage(
    events: Sequence[Event],
    geometry: Geometry,
    labels: Sequence[Label],
    choices: Choices,
    stage: str = "",
) -> Calibration:
    c, gathered = choices, gather(events, geometry, labels, stage=stage)
    return calibrate(
        gathered,
        geometry,
        ignore_places=c.ignore_places,
        offsets=c.offsets,
        exponent=c.exponent,
    )


def _clocks_alone(found: Calibration, stage: str) -> Calibration:
    """Return what arrivals tell of the clocks; the floor of ``stage``'s arrivals is another."""
    scale = replace(found.scale, identifiable=False)
    notes = (*found.notes, AGAIN.format(stage=stage))
    return replace(found, scale=scale, velocity=None, notes=notes)


def calibrate_replaying(
    replayed: Callable[[Geometry], Sequence[Event]],
    geometry: Geometry,
    labels: Sequence[Label],
    choices: Choices,
) -> tuple[Calibration, Geometry]:
    """Calibrate as :func:`calibrate_once`, and replay with what was found until clocks settle.

    Parameters
    ----------
    replayed
        Returns the events of a replay with a geometry.
    geometry, labels, choices
        As of :func:`calibrate_once`.

    Returns
    -------
    The last calibration, and the geometry that it was made with.
    """
    events = replayed(geometry)
    found = calibrate_once(events, geometry, labels, choices)
    for _ in range(PASSES if len(picking_stages(events)) > 1 else 0):
        after = calibrated_geometry(geometry, found)
        if _moved_s(geometry, after) <= SETTLED * found.arrival_sigma_s:
            break
        geometry = after
        finer = _by_stage(replayed(geometry), geometry, labels, choices)
        if finer.arrival_sigma_s > found.arrival_sigma_s:
            break
        found = finer
    return found, geometry


def _moved_s(before: Geometry, after: Geometry) -> float:
    """Return by how much two geometries differ in a clock at most [s]."""
    pairs = zip(before.sensors, after.sensors, strict=True)
    moved = [a.clock_offset_s - b.clock_offset_s for b, a in pairs]
    return float(np.abs(moved).max())
