from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import rerun as rr
from shot_sessions import SHOTS_S, arrival, shot_labels, write_shots
from viewer_sessions import NAMES, START_NS, at, read_back, write_room

from groundtrace_codecs.events import Label, Pick
from groundtrace_viewers.rerun.shots import (
    BEFORE_NS,
    FAR_HIGH,
    HIGH,
    MOST_SAMPLES,
    WIDE,
    Shot,
    line,
    scaled,
)
from groundtrace_viewers.rerun.sketch import thinned, ticks
from groundtrace_viewers.rerun.timeline import Timeline

if TYPE_CHECKING:
    from pathlib import Path

STRIPS = "LineStrips2D:strips"
SECTION, TRAVEL = "/shots/section", "/shots/travel"


@pytest.fixture(scope="module")
def shots(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_shots(tmp_path_factory.mktemp("shots") / "shots.rrd", shot_labels())


def strips(path: Path, entity: str) -> tuple[np.ndarray, list[Any]]:
    times, rows = read_back(path, entity, STRIPS)
    return times, [[np.array(one) for one in row] for row in rows]


def test_every_trace_is_scaled_to_itself_and_cut() -> None:
    t = np.arange(1000)
    wave = np.where(t > 600, np.sin(t), 0.0)
    shown = scaled(np.column_stack([wave * 1e-9, 5.0 + wave * 1e3, np.full(1000, 7.0)]))
    np.testing.assert_allclose(shown[:500], 0.0, atol=1e-9)
    np.testing.assert_allclose(np.abs(shown[:, :2]).max(axis=0), 1.0)
    np.testing.assert_array_equal(shown[:, 2], 0.0)


def test_of_too_many_samples_the_largest_stay() -> None:
    values = np.zeros((3 * MOST_SAMPLES, 2))
    values[100, 0], values[301, 1] = 5.0, -7.0
    times, kept = thinned(np.arange(len(values), dtype=float), values, MOST_SAMPLES)
    assert len(times) == len(kept) == MOST_SAMPLES
    assert (kept[:, 0].max(), kept[:, 1].min()) == (5.0, -7.0)


@pytest.mark.parametrize(("end", "last"), [(1.0, 1.0), (87.6, 100.0), (120.0, 120.0), (0.3, 0.3)])
def test_ticks_are_round_and_reach_the_end(end: float, last: float) -> None:
    assert ticks(end)[-1] == pytest.approx(last)
    assert 3 <= len(ticks(end)) <= 9


def test_each_shot_has_a_section_from_before_it_on(shots: Path) -> None:
    times, rows = strips(shots, f"{SECTION}/wiggle")
    np.testing.assert_array_equal(times, [0, SHOTS_S[1] * 1e9 - BEFORE_NS])
    assert [len(row) for row in rows] == [len(NAMES)] * 2
    for row in rows:
        for trace in row:
            assert trace[:, 1].min() >= 0.0
            assert trace[:, 1].max() <= HIGH + 1e-3
            assert np.all(np.diff(trace[:, 1]) > 0)  # time goes down


@pytest.mark.parametrize("rows", [7, 10_000])
@pytest.mark.parametrize("what", ["wiggle", "pick", "truth", "time"])
def test_the_section_does_not_depend_on_blocks(
    tmp_path: Path, shots: Path, rows: int, what: str
) -> None:
    again = write_shots(tmp_path / "again.rrd", shot_labels(), rows)
    component = "Points2D:positions" if what == "time" else STRIPS
    expected, found = (read_back(p, f"{SECTION}/{what}", component) for p in (shots, again))
    np.testing.assert_array_equal(found[0], expected[0])
    assert str(found[1]) == str(expected[1])


def test_picks_and_truth_lie_on_their_traces_at_their_times(shots: Path) -> None:
    centres = {}
    for what in ("pick", "truth"):
        _, rows = strips(shots, f"{SECTION}/{what}")
        centres[what] = np.array([np.mean(lines, axis=0) for lines in rows[0]])[::2]
    np.testing.assert_allclose(centres["pick"], centres["truth"], atol=1e-4)
    base = WIDE * np.arange(1, 5) / 5
    np.testing.assert_allclose(np.sort(centres["pick"][:, 0]), base, atol=1e-3)
    first_ms = (arrival(SHOTS_S[0], 0) - at(SHOTS_S[0])) / 1e6
    _, labels = read_back(shots, f"{SECTION}/time", "Points2D:labels")
    assert centres["pick"][0, 1] == pytest.approx(HIGH * first_ms / float(labels[0][-1]), abs=1e-3)


def test_offsets_are_told_from_the_shot(shots: Path) -> None:
    _, rows = read_back(shots, f"{SECTION}/offsets", "Points2D:labels")
    assert rows[0] == ["+2", "+4", "+6", "+8"]  # of a shot at -2 m


def test_without_labels_a_shot_begins_with_its_first_pick(tmp_path: Path) -> None:
    path = write_shots(tmp_path / "unlabelled.rrd", ())
    times, _ = read_back(path, f"{SECTION}/wiggle", STRIPS)
    starts = [arrival(s, 0) - START_NS - BEFORE_NS for s in SHOTS_S]
    np.testing.assert_array_equal(times, [0, starts[1]])
    _, lines = read_back(path, "/log/shots", "TextLog:text")
    assert [one[0].partition(";")[0] for one in lines] == [
        "shot 1: 4 of 4 picked",
        "shot 2: 4 of 4 picked",
    ]


def test_shots_close_to_each_other_have_the_picks_of_their_own(tmp_path: Path) -> None:
    labels = tuple(Label(at(s), "impact") for s in (1.0, 1.1, 1.2))
    path = write_shots(tmp_path / "close.rrd", labels)
    times, rows = strips(path, f"{SECTION}/pick")
    np.testing.assert_array_equal(
        times, [0, 1.05e9, 1.15e9, arrival(3.5, 0) - START_NS - BEFORE_NS]
    )
    assert [len(row) for row in rows] == [2 * len(NAMES), 0, 0, 2 * len(NAMES)]


def test_travel_times_of_all_shots_are_there_and_of_each_one_bold(shots: Path) -> None:
    _, now = strips(shots, f"{TRAVEL}/now")
    assert [len(row) for row in now] == [1, 1]
    curve = now[0][0]
    assert np.all(np.diff(curve[:, 0]) > 0)
    assert np.all(curve[:, 1] < 0)
    assert np.all(curve[:, 1] >= -FAR_HIGH)
    chunks = rr.chunk.RrdReader(str(shots)).stream().filter(content=f"{TRAVEL}/others")
    assert all(chunk.is_static for chunk in chunks)


def test_each_shot_is_one_line_of_the_log_and_no_pick_is(shots: Path) -> None:
    times, lines = read_back(shots, "/log/shots", "TextLog:text")
    np.testing.assert_array_equal(times, [s * 1e9 for s in SHOTS_S])
    assert [one[0] for one in lines] == [
        "shot 1: 4 of 4 right; 1.000 s",
        "shot 2: 4 of 4 right; 3.500 s",
    ]
    assert "/log/picks" not in rr.chunk.RrdReader(str(shots)).store().schema().entity_paths()


def test_only_the_last_picking_stage_has_a_say(shots: Path) -> None:
    times, _ = read_back(shots, "/picks/seismic", "Scalars:scalars")
    assert len(times) == len(SHOTS_S) * len(NAMES)
    _, stages = read_back(shots, "/table/picks", "stage")
    assert {s for [s] in stages} == {"first-breaks"}


def shot_of(errors_ms: dict[str, float | None]) -> Shot:
    """A shot whose picks are off by so much; None is not picked."""
    pick = Pick(0, "", "/seismic", "picker", 1e-3, 1.0)
    shot = Shot(START_NS, names=list(errors_ms), along=np.arange(float(len(errors_ms))))
    for name, error in errors_ms.items():
        shot.truth[name] = START_NS + 20_000_000
        if error is not None:
            time_ns = shot.truth[name] + round(error * 1e6)
            shot.picks[name] = replace(pick, channel=name, time_ns=time_ns)
    return shot


@pytest.mark.parametrize(
    ("errors", "text", "level"),
    [
        ({"A": 0.5, "B": -1.9, "C": 0.0}, "3 of 3 right", "INFO"),
        ({"A": 0.5, "B": 13.64, "C": 0.0}, "2 of 3 right, B 13.6 ms late", "WARN"),
        ({"A": -3.0, "B": 0.1, "C": None}, "1 of 3 right, A 3.0 ms early, 1 not picked", "ERROR"),
    ],
)
def test_a_line_says_how_many_are_right_and_the_worst(
    errors: dict[str, float | None], text: str, level: str
) -> None:
    timeline = Timeline(rr.RecordingStream("test"), START_NS)
    assert line(shot_of(errors), 7, timeline) == (f"shot 7: {text}; 0.000 s", level)


def test_a_wrong_pick_has_its_error_drawn_and_told(tmp_path: Path) -> None:
    labels = tuple(
        replace(x, time_ns=x.time_ns - 15_000_000)
        if x.kind == "pick" and x.channel == NAMES[1] and x.time_ns < at(2.0)
        else x
        for x in shot_labels()
    )
    path = write_shots(tmp_path / "wrong.rrd", labels)
    _, errors = strips(path, f"{SECTION}/error")
    assert [len(row) for row in errors] == [1, 0]
    [[(x, picked), (true_x, true)]] = errors[0]
    assert x == true_x
    assert picked > true
    _, texts = read_back(path, "/shots/picks", "TextDocument:text")
    assert "**3 right** to 2 ms, 0 early, 1 late, 0 not picked" in texts[0][0]
    assert f"| **{NAMES[1]}** | **+15.0** | 0.4 |" in texts[0][0]
    _, names = read_back(path, f"{TRAVEL}/names", "Points2D:labels")
    assert [list(row or ()) for row in names] == [[NAMES[1]], []]


def test_shots_are_places_but_no_path(shots: Path) -> None:
    paths = rr.chunk.RrdReader(str(shots)).store().schema().entity_paths()
    assert "/map/site/truth/footfalls" in paths
    assert "/map/site/truth/path" not in paths
    assert "/state/1-truth/pick" not in paths


def test_rooms_have_no_section(tmp_path: Path) -> None:
    paths = rr.chunk.RrdReader(str(write_room(tmp_path / "room.rrd"))).store().schema()
    assert not any(p.startswith("/shots") for p in paths.entity_paths())
