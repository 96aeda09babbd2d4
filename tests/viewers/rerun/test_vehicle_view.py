from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from vehicle_sessions import (
    BEFORE_M,
    PRESENCE,
    RATIOS,
    course,
    crossing,
    cycles,
    passes,
    ratios,
    stage,
    vehicle_session,
    written,
)
from viewer_sessions import at, read_back

from groundtrace_codecs.events import Fix, Pass, quantised
from groundtrace_viewers.rerun.moments import moments_of_session
from groundtrace_viewers.rerun.places import CROSSES
from groundtrace_viewers.rerun.site import bounds, signs
from groundtrace_viewers.rerun.timeline import about
from groundtrace_viewers.rerun.vehicles import (
    COURSE_HOLD_NS,
    COURSES,
    LIKELIHOOD,
    SHOWN_LEVELS,
    dashes,
)
from groundtrace_viewers.rerun.vehicles import LIKELIHOOD_HOLD_NS as IMAGE_NS

if TYPE_CHECKING:
    from pathlib import Path

SCALARS = "Scalars:scalars"
STRIPS = "LineStrips2D:strips"
STATES = "StateChange:state"


def entities(path: Path) -> list[str]:
    import rerun as rr

    return list(rr.chunk.RrdReader(str(path)).store().schema().entity_paths())


def told(path: Path, kind: str) -> list[str]:
    _, texts = read_back(path, f"/log/{kind}", "TextLog:text")
    return [text for [text] in texts]


def test_the_map_is_about_the_sensors_however_far_vehicles_come_from() -> None:
    shown = bounds(vehicle_session())
    assert shown is not None
    assert -BEFORE_M / 2 < shown.x[0] < 0 < 40 < shown.x[1] < BEFORE_M
    assert shown.y[0] < 0 < 5 < shown.y[1]


def test_signs_on_the_road_point_forward_and_are_evenly_apart() -> None:
    tips = np.array(signs([(0.0, 0.0), (10.0, 0.0), (10.0, 10.0)], 4.0, 1.0))
    np.testing.assert_allclose(tips[:, 1], [(0, 0), (4, 0), (8, 0), (10, 2), (10, 6)], atol=1e-5)
    back = tips[:, 1] - tips[:, [0, 2]].mean(axis=1)
    np.testing.assert_allclose(back, [(1, 0)] * 3 + [(0, 1)] * 2, atol=1e-5)


def test_the_likelihood_is_an_image_on_its_lattice_that_goes_out(tmp_path: Path) -> None:
    x, y = np.arange(-5.0, 6.0), np.arange(0.0, 4.0)
    values = -0.5 * ((x - 2) ** 2 + (y[:, None] - 1) ** 2)
    surfaces = [quantised(at(s), x, y, values, "likelihood") for s in (10.0, 10.5, 20.0)]
    path = written(tmp_path / "image.rrd", vehicle_session(), *surfaces)
    entity = f"{LIKELIHOOD}/likelihood"
    times, buffers = read_back(path, entity, "SegmentationImage:buffer")
    assert times.tolist() == [10_000_000_000, 10_500_000_000, 20_000_000_000]
    levels = np.array(buffers[0], np.uint8).reshape(4, 11)
    assert np.unravel_index(levels.argmax(), levels.shape) == (1, 7)
    assert levels.max() == SHOWN_LEVELS - 1
    times, opacity = read_back(path, entity, "SegmentationImage:opacity")
    dark = times[[value == [0.0] for value in opacity]]
    assert dark.tolist() == [10_500_000_000 + IMAGE_NS, 20_000_000_000 + IMAGE_NS]


def test_places_of_single_cycles_are_crosses(tmp_path: Path) -> None:
    fix = Fix(at(10), 12.0, 4.0, (1.0, 0.0, 1.0), 0.1, "likelihood", 3, "likelihood")
    path = written(tmp_path / "cross.rrd", vehicle_session(), stage("likelihood", "fix"), fix)
    _, strips = read_back(path, f"{CROSSES}/likelihood", STRIPS)
    np.testing.assert_allclose(np.array(strips[0][0])[2], (12.0, 4.0))
    assert not any("/fixes/points" in entity for entity in entities(path))


def test_dashes_have_gaps_as_long() -> None:
    line = np.array([(0.0, 0.0), (6.0, 0.0), (6.0, 5.0)])
    cut = dashes(line, 2.0)
    np.testing.assert_allclose(cut[:2], [[(0, 0), (2, 0)], [(4, 0), (6, 0)]], atol=1e-6)
    np.testing.assert_allclose(cut[2], [(6, 2), (6, 4)], atol=1e-6)


def test_a_course_is_dashed_from_its_first_place_on_and_the_vehicle_moves(tmp_path: Path) -> None:
    events = [stage("curve", "track"), stage("course", "track"), *course("curve")]
    path = written(tmp_path / "course.rrd", vehicle_session(), *events, *course("course"))
    times, strips = read_back(path, f"{COURSES}/course/1/course", STRIPS)
    assert times.tolist() == [10_000_000_000, 15_000_000_000 + COURSE_HOLD_NS]
    assert len(strips[0]) > 10
    assert strips[1] == []
    times, places = read_back(path, f"{COURSES}/course/1/place", "Points2D:positions")
    moving = np.array(places[:-1]).reshape(-1, 2)
    np.testing.assert_allclose(moving[:, 0], (times[:-1] / 1e9 - 10) * 10, atol=1e-4)
    assert places[-1] == []
    widths = {
        name: read_back(path, f"{COURSES}/{name}/1/course", "LineStrips2D:radii")[1][0][0]
        for name in ("curve", "course")
    }
    assert abs(widths["course"]) > abs(widths["curve"]), "the last stage is the one reported"
    _, states = read_back(path, "/state/6-course", STATES)
    assert [s for [s] in states] == ["V1 10.0 m/s", ""]


def test_crossings_of_the_last_stage_are_told_and_marked_and_all_are_rows(tmp_path: Path) -> None:
    events = [stage("curve", "track"), stage("course", "track")]
    found = [crossing("curve"), crossing("course")]
    path = written(tmp_path / "crossing.rrd", vehicle_session(), *events, *found)
    assert told(path, "crossings") == [
        "12.000 s ± 0.05 s  V1 10.0 ± 0.3 m/s crosses S1-S3 at (20.0, 0.0) ± 0.3 m"
    ]
    _, labels = read_back(path, "/map/site/crossings/S1-S3", "Points2D:labels")
    assert labels == [["", "S1-S3: 12.00 s, 10.0 m/s"]]
    _, rows = read_back(path, "/table/crossings", "stage")
    assert sorted(name for [name] in rows) == ["course", "curve"]


def test_passes_are_told_and_drawn_over_the_way_along_the_road(tmp_path: Path) -> None:
    path = written(tmp_path / "pass.rrd", vehicle_session(), stage("passes", "pass"), *passes())
    assert "10.050 s ± 0.04 s  V1 forward 10.0 ± 0.4 m/s at S1" in told(path, "passes")
    times, along = read_back(path, "/road/passes/S2/whose", SCALARS)
    assert len(times) == 2
    assert [value for [value] in along] == [BEFORE_M + 20.0] * 2
    for slot, speed in ((1, 10.0), (2, -8.0)):
        times, along = read_back(path, f"/road/vehicles/{slot}", SCALARS)
        rise = (along[1][0] - along[0][0]) / ((times[1] - times[0]) / 1e9)
        assert rise == pytest.approx(speed)
    for way, state in (("forward", "V1 10.0 m/s"), ("backward", "V2 8.0 m/s")):
        for lane in ("1-truth", "5-passes"):
            _, states = read_back(path, f"/state/{lane}/{way}", STATES)
            assert [s for [s] in states] == [state, ""]


@pytest.mark.parametrize("road", [True, False])
def test_truth_along_the_road_meets_the_passes(tmp_path: Path, road: bool) -> None:
    session = vehicle_session()
    if not road:
        assert session.geometry is not None
        session = replace(session, geometry=replace(session.geometry, road=()))
    path = written(tmp_path / "true.rrd", session, stage("passes", "pass"), *passes())
    times, along = read_back(path, "/road/truth/0", SCALARS)
    known = np.array(along).ravel()[:-1]
    assert len(known) >= 3
    first = BEFORE_M if road else 0.0
    np.testing.assert_allclose(known, first + (times[:-1] / 1e9 - 10) * 10, atol=1e-6)


def test_a_missed_and_a_false_pass_are_told_marked_and_listed(tmp_path: Path) -> None:
    session = vehicle_session()
    false = Pass(at(25), 0.1, "S1", 0, "", np.nan, np.nan, 0.5, 9.0, "passes")
    events = [stage("passes", "pass"), *passes((2, "S2")), false]
    path = written(tmp_path / "missed.rrd", session, *events)
    assert told(path, "score") == [
        "12.500 s  missed pass: V2 backward 8.0 m/s at S2",
        "25.000 s  false pass: a vehicle at S1 alone",
    ]
    times, _ = read_back(path, "/road/missed", SCALARS)
    assert times.tolist() == [12_500_000_000]
    times, _ = read_back(path, "/road/passes/S1/alone", SCALARS)
    assert times.tolist() == [25_000_000_000]
    listed = moments_of_session(session, events)
    assert [(m.t_s, m.kind, m.text) for m in listed.misses] == [
        (12.5, "missed", "V2 backward 8.0 m/s at S2"),
        (25.0, "false", "a vehicle at S1 alone"),
    ]
    assert listed.truth


def test_a_page_lists_passes_and_crossings() -> None:
    events = [stage("passes", "pass"), passes()[0], stage("course", "track"), crossing("course")]
    found = moments_of_session(vehicle_session(), events).events
    assert [(m.kind, m.text) for m in found] == [
        ("pass", "V1 forward 10.0 ± 0.4 m/s at S1"),
        ("crossing", "V1 10.0 ± 0.3 m/s crosses S1-S3 at (20.0, 0.0) ± 0.3 m"),
    ]


def test_the_lane_says_when_a_vehicle_is_heard_and_why_what_is_loud_is_none(
    tmp_path: Path,
) -> None:
    quiet, walker, vehicle = (1.0, 0.1), (9.0, 0.8), (12.0, 0.2)
    block = cycles([quiet, walker, walker, vehicle, vehicle, vehicle, quiet, quiet])
    path = written(tmp_path / "presence.rrd", vehicle_session(), PRESENCE, block)
    times, states = read_back(path, "/state/3-presence", STATES)
    assert [s for [s] in states] == ["no: cadence", "vehicle", ""]
    assert times.tolist() == [500_000_000, 1_500_000_000, 3_000_000_000]
    assert not any(entity.endswith("/rejected") for entity in entities(path))


def test_ratios_are_in_decibels_with_their_deviation_and_the_truth_by_the_law(
    tmp_path: Path,
) -> None:
    path = written(tmp_path / "ratio.rrd", vehicle_session(), PRESENCE, RATIOS, ratios(12.0))
    _, value = read_back(path, "/ratios/seismic/S3-S1/likelihood/value", SCALARS)
    assert value[0][0] == pytest.approx(10 * np.log10(4.0), abs=1e-4)
    _, bar = read_back(path, "/ratios/seismic/S3-S1/likelihood/sigma", SCALARS)
    assert bar[1][0] - bar[0][0] == pytest.approx(2 * 0.2 * 10 / np.log(10), abs=1e-4)
    times, true = read_back(path, "/ratios/seismic/S2-S1/truth/V1", SCALARS)
    here = true[int(np.flatnonzero(times == 12_000_000_000)[0])][0]
    r_s2, r_s1 = 5.0, np.hypot(20.0, 5.0)
    assert here == pytest.approx(10 * 2.0 * np.log10(r_s2 / r_s1), abs=1e-6)
    assert not any(entity.startswith("/detector/ratios") for entity in entities(path))


def test_without_places_there_is_no_map_and_passes_are_told(tmp_path: Path) -> None:
    session = vehicle_session(placed=False)
    events = [stage("course", "track"), *course("course"), crossing("course"), *passes()]
    path = written(tmp_path / "nowhere.rrd", session, *events)
    assert len(told(path, "passes")) == 6
    assert not any(entity.startswith(("/map", "/road")) for entity in entities(path))


def test_the_page_about_vehicles_is_about_vehicles() -> None:
    assert "Way along the road" in about(vehicle_session())
    assert "hodogram" not in about(vehicle_session()).lower()
