from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
import rerun as rr
from shot_sessions import SHOTS_S, arrival, shot_labels, write_shots
from viewer_sessions import NAMES, START_NS, at, read_back, write_room

from groundtrace_codecs.events import Label
from groundtrace_viewers.rerun.site import AFTER_NS, BEFORE_NS, DEFLECTION, scaled

if TYPE_CHECKING:
    from pathlib import Path

SCALARS = "Scalars:scalars"


@pytest.fixture(scope="module")
def shots(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_shots(tmp_path_factory.mktemp("shots") / "shots.rrd", shot_labels())


def test_every_trace_is_scaled_to_its_own_maximum_about_its_number() -> None:
    t = np.arange(1000)
    wave = np.where(t > 600, np.sin(t), 0.0)
    shown = scaled(np.column_stack([wave * 1e-9, 5.0 + wave * 1e3, np.full(1000, 7.0)]))
    np.testing.assert_allclose(shown[:500], np.tile([1.0, 2.0, 3.0], (500, 1)))
    np.testing.assert_allclose(np.abs(shown[:, :2] - [1, 2]).max(axis=0), DEFLECTION)
    np.testing.assert_array_equal(shown[:, 2], 3.0)


def test_the_section_holds_the_shots_and_nothing_between(shots: Path) -> None:
    times, values = read_back(shots, "/section/seismic/traces", SCALARS)
    traces = np.array(values)
    window = int((BEFORE_NS + AFTER_NS) / 5e5)
    assert traces.shape == (2 * (window + 1), 4)
    assert times[0] == SHOTS_S[0] * 1e9 - BEFORE_NS
    broken = np.flatnonzero(np.isnan(traces).all(axis=1))
    np.testing.assert_array_equal(broken, [window, 2 * window + 1])
    peaks = np.nanmax(np.abs(traces - np.arange(1, 5)), axis=0)
    np.testing.assert_allclose(peaks, DEFLECTION)


@pytest.mark.parametrize("rows", [7, 10_000])
def test_the_section_does_not_depend_on_blocks(tmp_path: Path, shots: Path, rows: int) -> None:
    again = write_shots(tmp_path / "again.rrd", shot_labels(), rows)
    expected, found = (read_back(p, "/section/seismic/traces", SCALARS) for p in (shots, again))
    np.testing.assert_array_equal(found[0], expected[0])
    np.testing.assert_array_equal(np.array(found[1]), np.array(expected[1]))


def test_without_labels_a_shot_begins_with_its_first_pick(tmp_path: Path) -> None:
    path = write_shots(tmp_path / "unlabelled.rrd", ())
    times, _ = read_back(path, "/section/seismic/traces", SCALARS)
    starts = times[np.flatnonzero(np.diff(times, prepend=-(10**9)) > 10**8)]
    np.testing.assert_array_equal(starts, [arrival(s, 0) - START_NS - BEFORE_NS for s in SHOTS_S])


def test_shots_close_to_each_other_share_no_sample(tmp_path: Path) -> None:
    labels = tuple(Label(at(s), "impact") for s in (1.0, 1.1, 1.2))
    path = write_shots(tmp_path / "close.rrd", labels)
    times, values = read_back(path, "/section/seismic/traces", SCALARS)
    shown = times[~np.isnan(np.array(values)).all(axis=1)]
    assert len(np.unique(shown)) == len(shown)
    assert {950_000_000, 1_100_000_000, 1_200_000_000} <= set(shown.tolist())


def test_picks_and_truth_lie_on_their_channels(shots: Path) -> None:
    for what in ("picks", "truth"):
        times, heights = read_back(shots, f"/section/seismic/{what}", SCALARS)
        assert heights == [[1.0], [2.0], [3.0], [4.0]] * 2
        expected = [arrival(s, c) - START_NS for s in SHOTS_S for c in range(4)]
        np.testing.assert_array_equal(times, expected)


def test_only_the_last_picking_stage_has_a_say(shots: Path) -> None:
    _, lines = read_back(shots, "/log/picks", "TextLog:text")
    assert len(lines) == len(SHOTS_S) * len(NAMES)
    assert all("(first-breaks)" in line for [line] in lines)
    times, _ = read_back(shots, "/picks/seismic", SCALARS)
    assert len(times) == len(SHOTS_S) * len(NAMES)
    _, stages = read_back(shots, "/table/picks", "stage")
    assert {s for [s] in stages} == {"first-breaks"}


def test_shots_are_places_but_no_path(shots: Path) -> None:
    paths = rr.chunk.RrdReader(str(shots)).store().schema().entity_paths()
    assert "/map/site/truth/footfalls" in paths
    assert "/map/site/truth/path" not in paths
    assert "/state/1-truth/pick" not in paths


def test_rooms_have_no_section(tmp_path: Path) -> None:
    paths = rr.chunk.RrdReader(str(write_room(tmp_path / "room.rrd"))).store().schema()
    assert not any(p.startswith("/section") for p in paths.entity_paths())
