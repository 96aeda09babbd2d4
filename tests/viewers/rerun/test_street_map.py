from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import rerun.blueprint as rrb
from viewer_sessions import START_NS, at, read_back, room_session

from groundtrace_codecs.events import Label, StageSpec, TrackPoint
from groundtrace_codecs.geometry import TangentPlane
from groundtrace_codecs.signals import Channel, SignalBlock, Stream
from groundtrace_viewers.rerun.blueprint import blueprint
from groundtrace_viewers.rerun.sink import RerunSink

if TYPE_CHECKING:
    from pathlib import Path

GNSS = Stream(
    "/gnss",
    (
        Channel("lat", "latitude", "deg"),
        Channel("lon", "longitude", "deg"),
        Channel("alt", "altitude", "m"),
    ),
    1.0,
)
STAGE = StageSpec("track", "?", "/gnss", ("all",), (), (), (), "track")


def walked(path: Path, monkeypatch: pytest.MonkeyPatch, *, map_tiles: bool) -> list[type[rrb.View]]:
    """Write a walk by satellite; return the kinds of views of its layout."""
    layouts: list[Any] = []

    def noted(*args: Any, **options: Any) -> rrb.Blueprint:
        layouts.append(blueprint(*args, **options))
        return layouts[-1]

    monkeypatch.setattr("groundtrace_viewers.rerun.sink.blueprint", noted)
    truth = tuple(Label(at(s), "step", x_m=s, y_m=2.0 * s) for s in range(5))
    session = replace(
        room_session(), application="walker", streams=(GNSS,), geometry=None, labels=truth
    )
    sink = RerunSink(path, map_tiles=map_tiles)
    sink.open(session)
    sink.write(STAGE)
    degrees = np.array([[48.0 + 1e-5 * k, 11.0 + 2e-5 * k, 500.0] for k in range(5)])
    sink.write(SignalBlock(GNSS, START_NS, 0, degrees))
    covariance = (0.1, 0.0, 0.1)
    for s in range(5):
        sink.write(TrackPoint(at(s), 1, float(s), 0.0, 1.0, 0.0, covariance, "track"))
    sink.close()
    return kinds(layouts[-1].root_container)


def kinds(part: Any) -> list[type[rrb.View]]:
    if isinstance(part, rrb.View):
        return [type(part)]
    return [kind for inner in part.contents for kind in kinds(inner)]


def test_there_is_no_street_map_unless_it_is_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert rrb.MapView not in walked(tmp_path / "a.rrd", monkeypatch, map_tiles=False)
    assert not len(read_back(tmp_path / "a.rrd", "/geo/satellites", "GeoPoints:positions")[0])


def test_fixes_and_tracks_lie_where_they_are_on_earth(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "b.rrd"
    assert walked(path, monkeypatch, map_tiles=True).count(rrb.MapView) == 1
    times, places = read_back(path, "/geo/satellites", "GeoPoints:positions")
    assert times.tolist() == [s * 10**9 for s in range(5)]
    np.testing.assert_allclose([p for [p] in places][4], (48.00004, 11.00008), atol=1e-9)
    _, places = read_back(path, "/geo/present", "GeoPoints:positions")
    (latitude, longitude) = [p for [p] in places][-1]
    assert latitude == pytest.approx(48.0)
    assert longitude == pytest.approx(11.0 + 4.0 / 74_625.0, abs=1e-6), "four metres to the east"


def test_a_place_on_the_plane_goes_back_to_its_position() -> None:
    plane = TangentPlane((3.0, -2.0))
    plane.map_position(0.8, 0.2)
    assert plane.position(*plane.map_position(0.80001, 0.19999)) == pytest.approx(
        (0.80001, 0.19999)
    )
    with pytest.raises(ValueError, match="expected a first fix"):
        TangentPlane().position(0.0, 0.0)
