"""``groundtrace export`` to GeoJSON and GPX: places on earth, right to 1e-7 degrees."""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import numpy as np
import pytest
from command_runs import done
from exported_sessions import of_kind, room_and_walk

from groundtrace.pipeline.results import read_results
from groundtrace_codecs.events import StepEvent, TrackPoint
from groundtrace_codecs.recording import Recording

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

Capture = pytest.CaptureFixture[str]
GPX = "{http://www.topografix.com/GPX/1/1}"
HERE = "46.52,6.5657"


@pytest.fixture(scope="module")
def replayed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return room_and_walk(tmp_path_factory.mktemp("maps"))


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(
    replayed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(replayed, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)


def ecef(latitude: float, longitude: float) -> NDArray[np.float64]:
    """Return a place on the ellipsoid WGS 84 in metres from the earth's centre."""
    lat, lon = math.radians(latitude), math.radians(longitude)
    e2 = 0.00669437999014
    radius = 6_378_137.0 / math.sqrt(1 - e2 * math.sin(lat) ** 2)
    flat = radius * math.cos(lat)
    return np.array([flat * math.cos(lon), flat * math.sin(lon), radius * (1 - e2) * math.sin(lat)])


def east_north(origin: tuple[float, float], place: tuple[float, float]) -> tuple[float, float]:
    """Return where a place lies from an origin [m]: an oracle of its own."""
    lat, lon = map(math.radians, origin)
    apart = ecef(*place) - ecef(*origin)
    east = np.array([-math.sin(lon), math.cos(lon), 0])
    flat = np.array([math.cos(lon), math.sin(lon)]) * -math.sin(lat)
    return float(east @ apart), float(np.array([*flat, math.cos(lat)]) @ apart)


def first_fix() -> tuple[float, float]:
    with Recording.open("walk.mcap") as recording:
        _, block = next(iter(recording.blocks(["/gnss"])))
    return float(block.values[0, 0]), float(block.values[0, 1])


def track_points() -> list[TrackPoint]:
    events = read_results(Path("walk.results.mcap")).events
    return [e for e in events if isinstance(e, TrackPoint) and e.stage == "track"]


#: 1e-7 degrees of latitude [m].
TENTH_MICRODEGREE_M = 0.0111


def assert_on_earth(places: Sequence[tuple[float, float]], points: Sequence[TrackPoint]) -> None:
    assert len(places) == len(points) > 10
    for place, point in zip(places, points, strict=True):
        found = east_north(first_fix(), place)
        assert found == pytest.approx((point.x_m, point.y_m), abs=TENTH_MICRODEGREE_M)


def test_geojson_places_a_walk_where_its_satellite_fixes_are(capsys: Capture) -> None:
    done(capsys, "export", "walk.results.mcap", "-o", "walk.geojson")
    features = json.loads(Path("walk.geojson").read_text("utf-8"))["features"]
    (line,) = [f for f in features if f["properties"].get("stage") == "track"]
    assert line["geometry"]["type"] == "LineString"
    places = [(lat, lon) for lon, lat in line["geometry"]["coordinates"]]
    assert_on_earth(places, track_points())
    steps = [f for f in features if f["properties"]["kind"] == "step"]
    told = [e for e in read_results(Path("walk.results.mcap")).events if isinstance(e, StepEvent)]
    assert len(steps) == len(told) > 10


def test_gpx_places_a_walk_and_dates_it(capsys: Capture) -> None:
    done(capsys, "export", "walk.results.mcap", "-o", "walk.gpx", "--kind", "tracks")
    root = ElementTree.parse("walk.gpx").getroot()
    tracks = {t.findtext(f"{GPX}name"): t for t in root.iter(f"{GPX}trk")}
    points = list(tracks["track 1"].iter(f"{GPX}trkpt"))
    places = [(float(p.get("lat", "")), float(p.get("lon", ""))) for p in points]
    assert_on_earth(places, track_points())
    assert points[0].findtext(f"{GPX}time", "").startswith("2026-01-05T09:00:0")
    assert not list(root.iter(f"{GPX}wpt"))


def test_a_room_lies_where_its_origin_is_told_and_turned_as_told(capsys: Capture) -> None:
    options = ("--kind", "fixes", "--stage", "so-tdoa", "--origin", f"{HERE},30")
    done(capsys, "export", "room.results.mcap", "-o", "room.geojson", *options)
    features = json.loads(Path("room.geojson").read_text("utf-8"))["features"]
    fixes = of_kind(read_results(Path("room.results.mcap")), "fixes")
    fixes = [fix for fix in fixes if fix.stage == "so-tdoa"]
    assert len(features) == len(fixes) > 3
    turn = math.radians(30)
    for feature, fix in zip(features, fixes, strict=True):
        x_m, y_m = fix.x_m, fix.y_m
        lon, lat = feature["geometry"]["coordinates"]
        found = east_north((46.52, 6.5657), (lat, lon))
        expected = (
            x_m * math.cos(turn) + y_m * math.sin(turn),
            y_m * math.cos(turn) - x_m * math.sin(turn),
        )
        assert found == pytest.approx(expected, abs=TENTH_MICRODEGREE_M)
