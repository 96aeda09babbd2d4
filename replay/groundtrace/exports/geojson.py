"""GeoJSON (RFC 7946): steps, fixes and tracks on the map, WGS 84."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import msgspec

from groundtrace_codecs.signals import NS_PER_S

from .api import Written
from .placed import PLACED, earth_of, fixes_of, placed_remarks, placed_steps, tracks_of
from .times import iso_utc

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from groundtrace_codecs.events import Fix, TrackPoint

    from .api import Material
    from .placed import Earth, PlacedStep

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
        found: dict[str, list[Feature]] = {
            "tracks": list(_tracks(material, earth)),
            "fixes": [_fix(fix, earth, start_ns) for fix in fixes_of(material)],
            "steps": [_step(step, earth, start_ns) for step in steps],
        }
        features = [f for kind, several in found.items() if kind in kinds for f in several]
        document = {"type": "FeatureCollection", "features": features}
        path.write_bytes(msgspec.json.encode(document))
        return Written({k: len(found[k]) for k in kinds}, placed_remarks(kinds, without))


def _feature(shape: str, coordinates: Any, **properties: Any) -> Feature:
    return {
        "type": "Feature",
        "geometry": {"type": shape, "coordinates": coordinates},
        "properties": {k: _known(v) for k, v in properties.items()},
    }


def _known(value: Any) -> Any:
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


def _tracks(material: Material, earth: Earth) -> Iterator[Feature]:
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
