"""One row for each of many channels: of the whole recording, by one scale and each by its own."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from viewer_sessions import NAMES, SEISMIC, blocks, read_back, room_session, seismic_samples

from groundtrace_codecs.signals import Channel
from groundtrace_viewers.rerun.signals import LEAST_ROWS, MOST_COLUMNS, ROW_HEIGHT
from groundtrace_viewers.rerun.sink import RerunSink
from groundtrace_viewers.rerun.timeline import SINGLES

if TYPE_CHECKING:
    from pathlib import Path

MANY = replace(
    SEISMIC,
    channels=tuple(Channel(f"G{i + 1}", "ground_velocity", "m/s", "z", 2e-9) for i in range(8)),
)
ONE, OWN = "/rows/one-scale/seismic", "/rows/each-its-own/seismic"


def written(path: Path, samples: np.ndarray, rows: int) -> Path:
    sink = RerunSink(path)
    sink.open(replace(room_session(), streams=(MANY,), geometry=None, labels=()))
    for block in blocks(MANY, samples, rows):
        sink.write(block)
    sink.close()
    return path


@pytest.fixture(scope="module")
def samples() -> np.ndarray:
    four = seismic_samples()
    return np.concatenate([four, four // 4], axis=1)


def test_each_channel_has_its_row_in_both_scales(tmp_path: Path, samples: np.ndarray) -> None:
    rrd = written(tmp_path / "many.rrd", samples, 1000)
    peaks = np.abs(samples).max(axis=0)
    numbers = np.arange(1, 9)
    for path, top in ((ONE, peaks.max()), (OWN, peaks)):
        _, values = read_back(rrd, path, SINGLES)
        rows = np.array(values)
        assert rows.shape[1] == 8
        assert np.all(rows >= numbers)
        assert np.all(rows < numbers + 1)
        highest = (rows - numbers).max(axis=0)
        np.testing.assert_allclose(highest, ROW_HEIGHT * peaks / top, atol=1 / 32)


def test_rows_are_those_of_the_whole_whatever_the_blocks(
    tmp_path: Path, samples: np.ndarray
) -> None:
    cut, whole = (written(tmp_path / f"{n}.rrd", samples, n) for n in (70, 12_000))
    for path in (ONE, OWN):
        times, values = read_back(cut, path, SINGLES)
        expected_times, expected = read_back(whole, path, SINGLES)
        np.testing.assert_array_equal(times, expected_times)
        np.testing.assert_array_equal(np.array(values), np.array(expected))
        assert len(times) <= 2 * MOST_COLUMNS


def test_few_channels_are_told_apart_in_one_plot(tmp_path: Path) -> None:
    assert len(NAMES) < LEAST_ROWS
    sink = RerunSink(tmp_path / "few.rrd")
    sink.open(room_session())
    for block in blocks(SEISMIC, seismic_samples(), 1000):
        sink.write(block)
    sink.close()
    assert len(read_back(tmp_path / "few.rrd", ONE, SINGLES)[0]) == 0
