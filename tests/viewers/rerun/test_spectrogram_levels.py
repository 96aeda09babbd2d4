from __future__ import annotations

import numpy as np
import pytest

from groundtrace_codecs.signals import Channel, SignalBlock, Stream
from groundtrace_viewers.rerun.spectrogram import (
    BANDS,
    MAX_POINTS,
    Averaged,
    BandLevels,
    resolution,
)

STREAM = Stream("/s", (Channel("G1", "ground_velocity", "m/s"),), 2000.0)
CUT = resolution(2000.0, 0.1, 250.0, 6.0)


def levels_of(x: np.ndarray, rows: int) -> tuple[np.ndarray, np.ndarray]:
    bands = BandLevels(CUT)
    parts = []
    for first in range(0, len(x), rows):
        piece = x[first : first + rows]
        parts.append(bands.push(SignalBlock(STREAM, 0, first, piece[:, np.newaxis]), piece))
    return np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts])


@pytest.mark.parametrize("rows", [1, 7, 200, 999])
def test_levels_do_not_depend_on_the_blocks(rows: int) -> None:
    x = np.random.default_rng(0).normal(size=2000)
    whole, cut = levels_of(x, len(x)), levels_of(x, rows)
    np.testing.assert_array_equal(cut[0], whole[0])
    np.testing.assert_array_equal(cut[1], whole[1])


@pytest.mark.parametrize("tone_hz", [40.0, 120.0, 200.0])
def test_a_tone_is_loudest_in_its_band(tone_hz: float) -> None:
    t = np.arange(4000) / 2000.0
    _, levels = levels_of(np.sin(2 * np.pi * tone_hz * t), 500)
    loudest = CUT.frequencies_hz(2000.0)[levels.mean(axis=0).argmax()]
    assert loudest == pytest.approx(tone_hz, abs=5.0)


def test_a_level_lies_at_the_middle_of_its_window() -> None:
    times, _ = levels_of(np.zeros(1000), 1000)
    assert times[0] == 50_000_000
    assert np.all(np.diff(times) == CUT.hop * 500_000)


def test_a_new_run_starts_afresh() -> None:
    bands = BandLevels(CUT)
    bands.push(SignalBlock(STREAM, 0, 0, np.ones((150, 1))), np.ones(150))
    times, _ = bands.push(SignalBlock(STREAM, 10**9, 0, np.ones((199, 1))), np.ones(199))
    assert len(times) == 0


@pytest.mark.parametrize("duration_s", [1.0, 30.0, 60.0, 600.0, 7200.0])
def test_the_number_of_squares_is_bounded(duration_s: float) -> None:
    cut = resolution(20_000.0, 0.1, 250.0, duration_s)
    columns = duration_s * 20_000.0 / (cut.hop * cut.pool)
    assert len(cut.edges) - 1 <= BANDS
    assert columns * BANDS <= 1.1 * MAX_POINTS
    assert min(columns, columns * 60.0 / duration_s) * BANDS < 60_000


@pytest.mark.parametrize("rows", [1, 7, 200, 999])
@pytest.mark.parametrize("begin", [0, 13, 20])
def test_means_do_not_depend_on_the_blocks(rows: int, begin: int) -> None:
    x = np.random.default_rng(0).normal(size=2000)
    averaged, found = Averaged(10), []
    for first in range(begin, len(x), rows):
        piece = x[first : first + rows]
        slower = averaged.push(SignalBlock(STREAM, 0, first, piece[:, np.newaxis]), piece)
        found += list(zip(slower.sample_times(), slower.samples[:, 0], strict=True))
    whole = x.reshape(-1, 10).mean(axis=1)[-(-begin // 10) :]
    np.testing.assert_allclose([value for _, value in found], whole, rtol=1e-12)
    assert found[0][0] == -(-begin // 10) * 5_000_000 + 2_250_000
    assert np.all(np.diff([time_ns for time_ns, _ in found]) == 5_000_000)
