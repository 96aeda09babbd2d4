"""Cells, noise ratio, local maxima: as a plain loop has them, whatever the blocks."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from replay_blocks import cuts_of, parts_of

from groundtrace.dsp.filters import UnbiasedMean
from groundtrace.dsp.noise import (
    CellReducer,
    LocalMaxima,
    NoiseRatio,
    RunningMaximum,
    SignalFrames,
)
from groundtrace.kernels.maxima import window_maxima

N = 203
RNG = np.random.default_rng(10)
RECORDED, FILTERED, LEVEL = RNG.normal(size=(3, 2, N))


def reduced(cuts=(), rate_hz=5000.0):
    reducer = CellReducer(rate_hz, SignalFrames(2, 1))
    rows = (RECORDED, FILTERED, LEVEL)
    pieces = zip(*(parts_of(r, cuts) for r in rows), strict=True)
    cells = [reducer.add(*piece) for piece in pieces]
    assert [c.first for c in cells] == np.cumsum([0, *map(len, cells)]).tolist()[:-1]
    frames = np.concatenate([c.frames for c in cells], axis=1)
    level = np.concatenate([c.level for c in cells], axis=1)
    return dict(
        zip(("level", "peak", "rms", "swing"), (level, *np.moveaxis(frames, -1, 0)), strict=False)
    )


@given(cuts=cuts_of(N))
def test_parts_give_exactly_the_cells_of_the_whole(cuts):
    whole = reduced()
    for name, column in reduced(cuts).items():
        assert np.array_equal(column, whole[name])


def test_cells_of_a_millisecond_hold_what_was_reached_in_them():
    cells, whole = reduced(), slice(0, 200)
    folded = [x[:, whole].reshape(2, 40, 5) for x in (RECORDED, FILTERED, LEVEL)]
    assert np.array_equal(cells["level"], folded[2].max(axis=2))
    assert np.array_equal(cells["peak"], np.abs(folded[1]).max(axis=2))
    assert np.allclose(cells["rms"] ** 2, (folded[1] ** 2).mean(axis=2), rtol=1e-12)
    assert np.array_equal(cells["swing"], np.ptp(folded[0], axis=2) / 2)


@pytest.mark.parametrize("rate_hz", [6.0, 500.0, 1000.0])
def test_at_low_rates_every_sample_is_a_cell(rate_hz):
    assert np.array_equal(reduced(rate_hz=rate_hz)["level"], LEVEL)


POSITIVE = np.abs(LEVEL) + 0.1
NOISES = {"mean": lambda: UnbiasedMean(20.0), "maximum": lambda: RunningMaximum(12)}


@pytest.mark.parametrize("noise", NOISES.values(), ids=NOISES)
@given(cuts=cuts_of(N), gap=st.integers(1, 30), warm_up=st.sampled_from([0.0, 7.5]))
def test_parts_give_exactly_the_ratio_of_the_whole(noise, cuts, gap, warm_up):
    ratio, whole = NoiseRatio(noise(), gap, warm_up), NoiseRatio(noise(), gap, warm_up)(POSITIVE)
    parts = [ratio(part) for part in parts_of(POSITIVE, cuts)]
    assert np.array_equal(np.concatenate(parts, axis=1), whole)


def test_the_ratio_is_to_the_noise_a_gap_earlier_and_trusted_with_time():
    gap, warm_up, cells = 4, 6.0, 12
    found = NoiseRatio(RunningMaximum(cells), gap, warm_up)(POSITIVE)[0]
    for k, value in enumerate(found):
        known = max(0, k - gap + 1)
        noise = POSITIVE[0, max(0, k - gap - cells + 1) : max(0, k - gap) + 1].max()
        expected = POSITIVE[0, k] / noise * known / (known + warm_up)
        assert value == pytest.approx(expected, rel=1e-12)


def test_silence_has_no_ratio():
    silent = np.zeros((1, 30))
    assert (NoiseRatio(RunningMaximum(5), 3, 0.0)(silent) == 0).all()


def test_a_running_maximum_is_that_of_the_last_cells():
    found = RunningMaximum(12)(POSITIVE)
    expected = [POSITIVE[:, max(0, k - 11) : k + 1].max(axis=1) for k in range(N)]
    assert np.array_equal(found, np.transpose(expected))
    assert np.array_equal(RunningMaximum(1)(POSITIVE), POSITIVE)


@pytest.mark.parametrize("width", [1, 2, 3, 8, 9])
def test_maxima_of_windows_are_those_of_every_window(width):
    windows = np.lib.stride_tricks.sliding_window_view(LEVEL, width, axis=1)
    assert np.array_equal(window_maxima(LEVEL, width), windows.max(axis=2))


def slow_maxima(values: np.ndarray, reach: int, floor: float, back: int) -> list[tuple]:
    """Look at every cell: first of equals within reach, over the floor; walk back its rise."""
    rises = []
    for cell in range(values.shape[1]):
        for channel, line in enumerate(values):
            before = line[max(0, cell - reach) : cell]
            after = line[cell + 1 : cell + 1 + reach]
            if line[cell] <= floor or (before >= line[cell]).any() or (after > line[cell]).any():
                continue
            begin = cell
            while begin > max(0, cell - back) and line[begin - 1] > floor:
                begin -= 1
            rises.append((begin, cell, channel, line[cell]))
    return rises


VALUES = st.lists(
    st.lists(st.sampled_from([0.0, 1.0, 2.0, 3.0, 4.0]), min_size=40, max_size=40),
    min_size=1,
    max_size=2,
).map(np.array)


@given(
    values=VALUES,
    reach=st.integers(1, 9),
    back=st.integers(0, 12),
    cuts=cuts_of(40),
    floor=st.sampled_from([0.0, 1.0]),
)
def test_maxima_are_those_of_a_look_at_every_cell_whatever_the_blocks(
    values, reach, back, cuts, floor
):
    maxima = LocalMaxima(len(values), reach, floor, back)
    found = [
        rise for part in parts_of(values, cuts) for rise in zip(*maxima.add(part), strict=True)
    ]
    settled = maxima.settled
    assert all(peak < settled for _, peak, _, _ in found)
    found += zip(*maxima.add(values[:, :0], final=True), strict=True)
    assert found == slow_maxima(values, reach, floor, back)
    assert settled == max(0, values.shape[1] - reach)


def test_a_plateau_has_one_maximum_at_its_begin():
    values = np.array([[0.0, 1, 5, 5, 5, 1, 0]])
    found = LocalMaxima(1, 2, 0.5, 3).add(values, final=True)
    assert list(zip(*found, strict=True)) == [(1, 2, 0, 5.0)]
