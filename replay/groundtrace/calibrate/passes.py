"""Clocks so far apart that waveforms cannot be compared: onsets tell them first.

Arrivals by correlation are an order finer than onsets, but presume that a delay is one that a wave
can take and turns phases as a wave does. A clock that is off by milliseconds does neither. Onsets
are what they are by any clock: so the clocks are told roughly by them, and with clocks known that
far, finely by correlation, nearer with each replay.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..errors import RecordingError
from ..localizers.floor import EXPONENT
from .arrivals import gather, picking_stages
from .estimate import calibrate, calibrated_geometry

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from groundtrace_codecs.events import Event
    from groundtrace_codecs.geometry import Geometry
    from groundtrace_codecs.labels import Label

    from .estimate import Calibration

#: Most replays, and the part of an arrival's deviation that clocks move by when they are settled.
PASSES, SETTLED = 8, 0.25
AGAIN = (
    "scale, exponent: of onsets, which tell clocks so far apart better than {stage}: left as they "
    "were; replay with the geometry found, then calibrate again"
)


def calibrate_once(
    events: Sequence[Event],
    geometry: Geometry,
    labels: Sequence[Label],
    *,
    ignore_places: bool = False,
    offsets: str = "auto",
    exponent: float = EXPONENT,
) -> Calibration:
    """Calibrate by the last stage that picks; only the clocks by one before where that is better.

    Parameters
    ----------
    events, labels
        As of :func:`.arrivals.gather`.
    geometry, ignore_places, offsets
        As of :func:`.estimate.calibrate`.
    exponent
        Of the arrivals of the last stage, where they do not tell it.

    Raises
    ------
    RecordingError
        As those two do.
    """
    last = gather(events, geometry, labels)
    found = calibrate(
        last, geometry, ignore_places=ignore_places, offsets=offsets, exponent=exponent
    )
    stages = picking_stages(events)
    for stage in stages[:-1] if offsets != "no" else ():
        try:
            other = calibrate(
                gather(events, geometry, labels, stage=stage),
                geometry,
                ignore_places=ignore_places,
                offsets=offsets,
            )
        except RecordingError:
            continue
        if other.offsets_estimated and other.arrival_sigma_s < found.arrival_sigma_s:
            found = _clocks_alone(other, stages[-1])
    return found


def _clocks_alone(found: Calibration, stage: str) -> Calibration:
    """Return what arrivals tell of the clocks; the floor of ``stage``'s arrivals is another."""
    scale = replace(found.scale, identifiable=False)
    notes = (*found.notes, AGAIN.format(stage=stage))
    return replace(found, scale=scale, velocity=None, notes=notes)


def calibrate_replaying(
    replayed: Callable[[Geometry], Sequence[Event]],
    geometry: Geometry,
    labels: Sequence[Label],
    *,
    ignore_places: bool = False,
    offsets: str = "auto",
    exponent: float = EXPONENT,
) -> tuple[Calibration, Geometry]:
    """Calibrate as :func:`calibrate_once`, and replay with what was found until clocks settle.

    Parameters
    ----------
    replayed
        Returns the events of a replay with a geometry.
    geometry, labels, ignore_places, offsets, exponent
        As of :func:`calibrate_once`.

    Returns
    -------
    The last calibration, and the geometry that it was made with.
    """
    for _ in range(PASSES):
        events = replayed(geometry)
        found = calibrate_once(
            events,
            geometry,
            labels,
            ignore_places=ignore_places,
            offsets=offsets,
            exponent=exponent,
        )
        after = calibrated_geometry(geometry, found)
        moved_s = _moved_s(geometry, after)
        if len(picking_stages(events)) < 2 or moved_s <= SETTLED * found.arrival_sigma_s:
            break
        geometry = after
    return found, geometry


def _moved_s(before: Geometry, after: Geometry) -> float:
    """Return by how much two geometries differ in a clock at most [s]."""
    pairs = zip(before.sensors, after.sensors, strict=True)
    moved = [a.clock_offset_s - b.clock_offset_s for b, a in pairs]
    return float(np.abs(moved).max())
