from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
import rerun as rr
from viewer_sessions import NAMES, STEPS_S, read_back, write_room, write_walker

from groundtrace_viewers.rerun.timeline import Bounds
from groundtrace_viewers.rerun.waves import (
    AHEAD_NS,
    LEVELS,
    MOST_SAMPLES,
    averaged,
    scaled,
)

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_room(tmp_path_factory.mktemp("room") / "room.rrd")


def test_the_waves_of_each_step_are_there_from_before_it_on(room: Path) -> None:
    times, rows = read_back(room, "/waves/trace", "LineStrips2D:strips")
    expected = [0, *(round(s * 1e9) - AHEAD_NS for s in STEPS_S[1:])]
    np.testing.assert_array_equal(times, expected)
    for row in rows:
        assert len(row) == len(NAMES)
        middles = [np.median(np.array(trace)[:, 1]) for trace in row]
        assert np.all(np.diff(middles) > 0)
        assert all(len(trace) <= MOST_SAMPLES for trace in row)


@pytest.mark.parametrize("rows", [7, 10_000])
def test_waves_do_not_depend_on_blocks(tmp_path: Path, room: Path, rows: int) -> None:
    again = write_room(tmp_path / "again.rrd", rows)
    expected, found = (read_back(p, "/waves/trace", "LineStrips2D:strips") for p in (room, again))
    np.testing.assert_array_equal(found[0], expected[0])
    assert found[1] == expected[1]


def test_a_missed_step_says_what_each_channel_lacked(room: Path) -> None:
    _, yes = read_back(room, "/waves/yes", "Points2D:labels")
    _, no = read_back(room, "/waves/no", "Points2D:labels")
    assert [len(row or ()) for row in yes] == [8, 8, 0, 8, 8, 8, 8, 8]
    assert sorted(no[2]) == sorted([*NAMES, "3", "3", "3", "3"])
    _, below = read_back(room, "/waves/below", "LineStrips2D:strips")
    assert [len(row or ()) for row in below] == [0, 0, 2 * len(NAMES), 0, 0, 0, 0, 0]
    assert sorted(yes[0]) == sorted([*NAMES, "6", "7", "8", "9"])


def test_traces_of_a_step_are_scaled_alike_and_cut() -> None:
    wave = np.sin(np.linspace(0, 20, 200))
    shown = scaled(np.column_stack([wave * 1e-9, wave * 1e-6, wave * 1e-3]))
    assert np.abs(shown).max(axis=0).tolist() == [0, LEVELS, LEVELS]
    assert (np.abs(shown[:, 2]) == LEVELS).mean() > 0.9
    assert not scaled(np.zeros((5, 3))).any()


def test_averages_keep_the_mean() -> None:
    values = np.random.default_rng(1).normal(size=(10 * MOST_SAMPLES, 2))
    times, kept = averaged(np.arange(len(values), dtype=float), values)
    assert len(times) == len(kept) == MOST_SAMPLES
    np.testing.assert_allclose(kept.mean(axis=0), values.mean(axis=0), atol=1e-12)


def test_walkers_have_no_waves(tmp_path: Path) -> None:
    paths = rr.chunk.RrdReader(str(write_walker(tmp_path / "w.rrd"))).store().schema()
    assert not any(p.startswith("/waves") for p in paths.entity_paths())


def test_the_key_of_a_square_site_goes_beyond_its_sides_that_of_a_wide_one_does_not() -> None:
    square, wide = Bounds((0, 10), (0, 10)), Bounds((0, 40), (0, 10))
    assert np.ptp(square.key(4, 0.5)[:, 0]) == pytest.approx(10.5)
    assert np.ptp(wide.key(4, 0.5)[:, 0]) == pytest.approx(30.0)
