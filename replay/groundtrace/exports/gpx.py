"""GPX 1.1: tracks as tracks, steps and fixes as waypoints, WGS 84."""

from __future__ import annotations

from typing import TYPE_CHECKING
from xml.etree.ElementTree import Element, ElementTree, SubElement, indent

from ..version import installed_version
from .api import Written
from .placed import (
    DIGITS,
    PLACED,
    earth_of,
    fixes_of,
    placed_remarks,
    placed_steps,
    tracks_of,
)
from .times import iso_utc

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from .api import Material
    from .placed import Earth

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
            counts["tracks"] = sum(1 for _ in _tracks(root, material, earth))
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


def _tracks(root: Element, material: Material, earth: Earth) -> Iterator[Element]:
    """Write the tracks; yield each."""
    for (stage, number), points in tracks_of(material).items():
        track = SubElement(root, "trk")
        SubElement(track, "name").text = f"{stage} {number}"
        SubElement(track, "number").text = str(number)
        segment = SubElement(track, "trkseg")
        for p in points:
            _point(segment, "trkpt", earth, p.x_m, p.y_m, p.time_ns)
        yield track
