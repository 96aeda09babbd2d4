"""What has a place on earth: fixes, tracks and steps by latitude and longitude."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from groundtrace_codecs.earth import ORIGIN
from groundtrace_codecs.events import Fix, StepEvent, TrackPoint

from ..errors import RecordingError
from ..reckoning.places import TangentPlane, satellite_columns, satellite_fixes
from .api import Origin
from .kinds import events_of_kind

if TYPE_CHECKING:
    from collections.abc import Sequence

    from .api import Material

#: Kinds that have a place.
PLACED = ("steps", "fixes", "tracks")
#: Digits of a degree that are written: a tenth of a millimetre.
DIGITS = 9


@dataclass(frozen=True, slots=True)
class Earth:
    """Turns places of the site into degrees.

    Attributes
    ----------
    plane
        Touches the ellipsoid at the site's origin.
    azimuth_rad
        Direction of the site's y axis, clockwise from north.
    """

    plane: TangentPlane
    azimuth_rad: float = 0.0

    def degrees(self, x_m: float, y_m: float) -> tuple[float, float]:
        """Return latitude and longitude [deg]."""
        turn = self.azimuth_rad
        east = x_m * math.cos(turn) + y_m * math.sin(turn)
        north = y_m * math.cos(turn) - x_m * math.sin(turn)
        latitude, longitude = map(math.degrees, self.plane.position(east, north))
        return round(latitude, DIGITS), round(longitude, DIGITS)


def earth_of(material: Material) -> Earth:
    """Return where the site lies: as somebody or the recording says, or by the first fix.

    The first fix of the replayed span lies where the walk starts on the map, x to the east, as
    dead reckoning has it.

    Raises
    ------
    RecordingError
        Where nothing tells it, or the site's unit of length is unknown.
    """
    site = material.geometry
    if site is not None and site.length_unit != "m":
        raise RecordingError(
            f"{material.name}: geometry: expected metres, found an unknown unit of length"
        )
    if material.origin is not None:
        return _told(material.origin)
    found = _imported(material)
    if found is not None:
        return _told(found)
    plane = TangentPlane(site.start if site is not None and site.start else (0.0, 0.0))
    _hear_first_fix(material, plane)
    if plane.origin is None:
        raise RecordingError(
            f"{material.name}: expected a geographic reference: satellite fixes in the recording, "
            f"or --origin LATITUDE,LONGITUDE of the site's zero, found neither"
        )
    return Earth(plane)


def _told(origin: Origin) -> Earth:
    plane = TangentPlane((0.0, 0.0), (origin.latitude_rad, origin.longitude_rad))
    return Earth(plane, origin.azimuth_rad)


def _imported(material: Material) -> Origin | None:
    """Return where the recording says that its zero lies, as an import from StationXML writes."""
    recording = material.recording()
    record = {} if recording is None else recording.metadata.get(ORIGIN, {})
    try:
        return Origin(*(math.radians(float(record[f"{k}_deg"])) for k in ("latitude", "longitude")))
    except (KeyError, ValueError):
        return None


def _hear_first_fix(material: Material, plane: TangentPlane) -> None:
    """Let the plane know the first finite fix."""
    recording = material.recording()
    if recording is None:
        return
    topics = [s.topic for s in recording.streams if satellite_columns(s) is not None]
    if not topics:
        return
    for _, block in recording.blocks(topics, start_ns=material.from_ns):
        satellite_fixes(block, plane, 0.0)
        if plane.origin is not None:
            return


@dataclass(frozen=True, slots=True)
class PlacedStep:
    """A step where a fix or a track has one of its time."""

    step: StepEvent
    x_m: float
    y_m: float


def placed_steps(material: Material) -> tuple[list[PlacedStep], int]:
    """Return the steps that have a place, and how many have none.

    A step itself has no place: it is where the last stage that places it, a tracker before a
    localizer, has a point of the same time.
    """
    steps = [e for e in events_of_kind(material, "steps") if isinstance(e, StepEvent)]
    where: dict[int, tuple[float, float]] = {}
    for kind in ("fixes", "tracks"):
        for event in events_of_kind(material, kind):
            if isinstance(event, Fix | TrackPoint) and math.isfinite(event.x_m + event.y_m):
                where[event.time_ns] = (event.x_m, event.y_m)
    found = [PlacedStep(s, *where[s.time_ns]) for s in steps if s.time_ns in where]
    return found, len(steps) - len(found)


def fixes_of(material: Material) -> list[Fix]:
    """Return the finite fixes by time."""
    events = events_of_kind(material, "fixes")
    return [e for e in events if isinstance(e, Fix) and math.isfinite(e.x_m + e.y_m)]


def tracks_of(material: Material) -> dict[tuple[str, int], list[TrackPoint]]:
    """Return the finite points of each track, by stage and number, in order of time."""
    tracks: dict[tuple[str, int], list[TrackPoint]] = {}
    for e in events_of_kind(material, "tracks"):
        if isinstance(e, TrackPoint) and math.isfinite(e.x_m + e.y_m):
            tracks.setdefault((e.stage, e.track), []).append(e)
    return tracks


def placed_remarks(kinds: Sequence[str], without: int) -> tuple[str, ...]:
    """Say what had no place."""
    if "steps" not in kinds or not without:
        return ()
    return (f"{without} steps are left out: no fix or track has a point of their time",)
