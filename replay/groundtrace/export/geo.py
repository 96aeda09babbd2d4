"""Exports for maps: steps, fixes and tracks as GeoJSON (RFC 7946) and GPX, WGS 84."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any
from xml.etree.ElementTree import Element, ElementTree, SubElement, indent

import msgspec

from groundtrace_codecs.events import Fix, StepEvent, TrackPoint
from groundtrace_codecs.geometry import TangentPlane, tangent_plane
from groundtrace_codecs.signals import NS_PER_S

from ..errors import RecordingError
from ..inertial.steps import satellite_columns, satellite_fixes
from ..runtime import installed_version
from .base import Written, events_of_kind, iso_utc

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from .base import Material

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
        touched = (material.origin.latitude_rad, material.origin.longitude_rad)
        return Earth(TangentPlane(origin=touched), material.origin.azimuth_rad)
    plane = tangent_plane(site)
    _hear_first_fix(material, plane)
    if plane.origin is None:
        raise RecordingError(
            f"{material.name}: expected a geographic reference: satellite fixes in the recording, "
            f"or --origin LATITUDE,LONGITUDE of the site's zero, found neither"
        )
    return Earth(plane)


def _hear_first_fix(material: Material, plane: TangentPlane) -> None:
    """Let the plane know the first finite fix."""
    recording = material.recording()
    if recording is None or plane.origin is not None:
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
    placed = [PlacedStep(s, *where[s.time_ns]) for s in steps if s.time_ns in where]
    return placed, len(steps) - len(placed)


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


Feature = dict[str, Any]


class GeoJsonExporter:
    """Writes a feature for each step, fix and track; a track is a line with its times."""

    name = "geojson"
    description = "steps, fixes and tracks for maps; needs a geographic reference"
    suffixes = (".geojson",)
    kinds = PLACED
    one_kind = False

    def write(self, material: Material, kinds: Sequence[str], path: Path) -> Written:
        """Write the features."""
        earth = earth_of(material)
        steps, without = placed_steps(material)
        start_ns = material.start_ns
        by_kind: dict[str, list[Feature]] = {
            "tracks": list(_geojson_tracks(material, earth)),
            "fixes": [_fix(fix, earth, start_ns) for fix in fixes_of(material)],
            "steps": [_step(step, earth, start_ns) for step in steps],
        }
        features = [f for kind, several in by_kind.items() if kind in kinds for f in several]
        document = {"type": "FeatureCollection", "features": features}
        path.write_bytes(msgspec.json.encode(document))
        return Written({k: len(by_kind[k]) for k in kinds}, placed_remarks(kinds, without))


def _feature(shape: str, coordinates: Any, **properties: Any) -> Feature:
    return {
        "type": "Feature",
        "geometry": {"type": shape, "coordinates": coordinates},
        "properties": {k: _finite_or_null(v) for k, v in properties.items()},
    }


def _finite_or_null(value: Any) -> Any:
    """Return a value as JSON can hold it: not a number is null."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _coordinates(earth: Earth, x_m: float, y_m: float) -> list[float]:
    latitude, longitude = earth.degrees(x_m, y_m)
    return [longitude, latitude]


def _when(time_ns: int, start_ns: int) -> dict[str, Any]:
    return {"time_s": (time_ns - start_ns) / NS_PER_S, "time_utc": iso_utc(time_ns)}


def _step(placed: PlacedStep, earth: Earth, start_ns: int) -> Feature:
    step = placed.step
    return _feature(
        "Point",
        _coordinates(earth, placed.x_m, placed.y_m),
        kind=step.kind,
        **_when(step.time_ns, start_ns),
        foot=step.foot,
        type=step.type,
        stage=step.stage,
        x_m=placed.x_m,
        y_m=placed.y_m,
    )


def _fix(fix: Fix, earth: Earth, start_ns: int) -> Feature:
    return _feature(
        "Point",
        _coordinates(earth, fix.x_m, fix.y_m),
        kind="fix",
        **_when(fix.time_ns, start_ns),
        method=fix.method,
        stage=fix.stage,
        x_m=fix.x_m,
        y_m=fix.y_m,
    )


def _geojson_tracks(material: Material, earth: Earth) -> Iterator[Feature]:
    for (stage, number), points in tracks_of(material).items():
        places = [_coordinates(earth, p.x_m, p.y_m) for p in points]
        alone = len(places) == 1  # a line has two places
        yield _feature(
            "Point" if alone else "LineString",
            places[0] if alone else places,
            kind="track",
            stage=stage,
            track=number,
            time_s=_seconds(points, material.start_ns),
            time_utc=[iso_utc(p.time_ns) for p in points],
        )


def _seconds(points: Sequence[TrackPoint], start_ns: int) -> list[float]:
    return [(p.time_ns - start_ns) / NS_PER_S for p in points]


NAMESPACE = "http://www.topografix.com/GPX/1/1"


class GpxExporter:
    """Writes what phones, maps and GIS programs open; clocks without a date give no times."""

    name = "gpx"
    description = "steps, fixes and tracks for maps; needs a geographic reference"
    suffixes = (".gpx",)
    kinds = PLACED
    one_kind = False

    def write(self, material: Material, kinds: Sequence[str], path: Path) -> Written:
        """Write waypoints, then tracks: the order that the format wants."""
        earth = earth_of(material)
        creator = f"groundtrace {installed_version()}"
        root = Element("gpx", xmlns=NAMESPACE, version="1.1", creator=creator)
        steps, without = placed_steps(material)
        counts = dict.fromkeys(kinds, 0)
        if "steps" in kinds:
            for placed in steps:
                step = placed.step
                name = " ".join(filter(None, (step.kind, step.type, step.foot)))
                point = _point(root, "wpt", earth, placed.x_m, placed.y_m, step.time_ns)
                _named(point, name, step.stage, "step")
            counts["steps"] = len(steps)
        if "fixes" in kinds:
            for fix in fixes_of(material):
                point = _point(root, "wpt", earth, fix.x_m, fix.y_m, fix.time_ns)
                _named(point, "fix", f"{fix.stage} {fix.method}".strip(), "fix")
                counts["fixes"] += 1
        if "tracks" in kinds:
            counts["tracks"] = sum(1 for _ in _gpx_tracks(root, material, earth))
        indent(root)
        ElementTree(root).write(path, "utf-8", xml_declaration=True)
        return Written(counts, placed_remarks(kinds, without))


def _point(
    parent: Element, tag: str, earth: Earth, x_m: float, y_m: float, time_ns: int
) -> Element:
    latitude, longitude = earth.degrees(x_m, y_m)
    degrees = {"lat": f"{latitude:.{DIGITS}f}", "lon": f"{longitude:.{DIGITS}f}"}
    point = SubElement(parent, tag, degrees)
    date = iso_utc(time_ns)
    if date is not None:
        SubElement(point, "time").text = date
    return point


def _named(point: Element, name: str, description: str, kind: str) -> None:
    for tag, text in (("name", name), ("desc", description), ("type", kind)):
        SubElement(point, tag).text = text


def _gpx_tracks(root: Element, material: Material, earth: Earth) -> Iterator[Element]:
    """Write the tracks; yield each."""
    for (stage, number), points in tracks_of(material).items():
        track = SubElement(root, "trk")
        SubElement(track, "name").text = f"{stage} {number}"
        SubElement(track, "number").text = str(number)
        segment = SubElement(track, "trkseg")
        for p in points:
            _point(segment, "trkpt", earth, p.x_m, p.y_m, p.time_ns)
        yield track
