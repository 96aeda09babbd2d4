"""Kernels of arrival pickers against plain Python, sample by sample, on any signal.

With ``NUMBA_DISABLE_JIT=1`` they run as the plain Python that they are written in.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from plain_python import inputs

from groundtrace.dsp.filters import bandpass
from groundtrace.dsp.noise import SignalFrames
from groundtrace.dsp.spectral import WindowPower
from groundtrace.kernels import frames, grid, locate, maxima, picker

RNG = np.random.default_rng(22)
COLUMNS = 3
CHANNELS = inputs((1, 3, 8, 9, 16, 17, 33), (1, 9))
TINY = 5e-324


def signals(n: int, channels: int) -> dict[str, np.ndarray]:
    """Return signals that are hard on a filter, each (n, channels)."""
    noise = 1e-6 * RNG.normal(size=(n, channels))
    burst = np.where(np.arange(n)[:, None] < n // 2, 0.0, noise)
    hostile = noise.copy()
    hostile[n // 3], hostile[n // 2], hostile[-1, 0] = np.nan, np.inf, -np.inf
    denormal = TINY * RNG.integers(-9, 9, (n, channels))
    return {
        "noise": noise,
        "zeros": 0.0 * noise,
        "constant": np.full_like(noise, 0.7),
        "out of silence": burst,
        "denormal": denormal,
        "large": 1e300 * noise,
        "not finite": hostile,
    }


def cells_of(x: np.ndarray, sos: np.ndarray, alpha: float, length: int) -> tuple[list, list]:
    """Filter one channel, sum its cells up: rows (level, peak, power, high, low)."""
    memory, level = [[0.0, 0.0] for _ in sos], 0.0
    filtered, cells, cell = [], [], []
    for recorded in x.tolist():
        y = recorded
        for (b0, b1, b2, _, a1, a2), m in zip(sos.tolist(), memory, strict=True):
            given, y = y, b0 * y + m[0]
            m[0], m[1] = b1 * given - a1 * y + m[1], b2 * given - a2 * y
        level = alpha * (y * y) + (1.0 - alpha) * level
        filtered.append(y)
        cell.append((level, y, recorded))
        if len(cell) == length:
            levels, ys, xs = (np.array(v) for v in zip(*cell, strict=True))
            total = 0.0
            for value in ys.tolist():
                total += value * value
            peak, power = np.fmax.reduce(np.abs(ys), initial=0.0), total / length
            ends = np.fmax.reduce(xs, initial=-np.inf), np.fmin.reduce(xs, initial=np.inf)
            cells.append((np.fmax.reduce(levels, initial=-np.inf), peak, power, *ends))
            cell = []
            level = 0.0 if abs(level) < picker.NOTHING else level
            memory = [[0.0 if abs(v) < picker.NOTHING else v for v in m] for m in memory]
    return filtered, cells


def picked(x: np.ndarray, sos: np.ndarray, alpha: float, length: int, block: int) -> tuple:
    """Run the kernel over blocks: rows filtered, levels of cells, frames of COLUMNS cells."""
    n, channels = x.shape
    rows, found, filled = np.empty(x.shape), [], 0
    state = picker.channels_of(np.ones(channels), np.zeros((4, channels)))
    sections, frame = picker.sections_of(sos), SignalFrames(channels, COLUMNS)
    for start in range(0, n, block):
        part, filtered = x[start : start + block], rows[start : start + block]
        complete, columns = (filled + len(part)) // length, frame.filled
        levels, values = np.empty((channels, complete)), frame.completed_by(complete)
        of_frame = (frame.open_frame, columns, COLUMNS)
        picker.variance_cells(part.dtype)(
            part, sections, alpha, state, filled, length, *of_frame, filtered, levels, values
        )
        filled = (filled + len(part)) % length
        found.append((levels, values))
    levels, values = (np.concatenate(each, axis=1) for each in zip(*found, strict=True))
    return rows, levels, np.concatenate([values, frame.flush()], axis=1)


def frame_of(columns: list[tuple[float, ...]]) -> tuple[float, ...]:
    """Return what a frame of columns (peak, power, high, low) tells, step by step."""
    largest, total, highest, lowest = -math.inf, 0.0, -math.inf, math.inf
    for peak, power, high, low in columns:
        largest, total = max(largest, peak), total + power
        highest, lowest = max(highest, high), min(lowest, low)
    flat = 0
    for (_, _, *before), (_, _, high, low) in pairwise(columns):
        flat += high == low and before == [high, low] and high in (highest, lowest)
    level = math.sqrt(total / len(columns)) if total >= 0.0 else math.nan
    return largest, level, (highest - lowest) / 2.0, flat


@pytest.mark.filterwarnings("ignore:.*encountered in:RuntimeWarning")
@pytest.mark.parametrize("channels", CHANNELS)
@pytest.mark.parametrize("block", inputs([1, 7, 50, 120], [50]))
@pytest.mark.parametrize("order", inputs([0, 1, 2], [2]))
def test_cells_are_those_of_a_plain_loop_to_the_last_bit(channels, block, order):
    sos = bandpass(20.0, 0.0 if order == 1 else 400.0, 2000.0) if order else bandpass(0, 0, 2000.0)
    for name, x in signals(120, channels).items():
        rows, levels, frame = picked(x, sos, 0.2, 7, block)
        for c in range(channels):
            filtered, cells = cells_of(x[:, c], sos, 0.2, 7)
            assert np.array_equal(rows[:, c], filtered, equal_nan=True), name
            assert np.array_equal(levels[c], [level for level, *_ in cells], equal_nan=True), name
            columns = [tuple(map(float, cell[1:])) for cell in cells]
            groups = [columns[k : k + COLUMNS] for k in range(0, len(columns), COLUMNS)]
            expected = [frame_of(group) for group in groups]
            assert np.array_equal(frame[c], expected, equal_nan=True), name


@pytest.mark.parametrize("kind", picker.STORED)
@pytest.mark.parametrize("planar", [True, False])
def test_cells_are_the_same_however_samples_are_stored(kind, planar):
    whole = RNG.integers(-3000, 3000, (120, 9))
    stored = np.frombuffer(b"0" + whole.T.astype(kind).tobytes(), kind, offset=1).reshape(9, 120).T
    stored = stored if planar else stored.copy()
    sos = bandpass(20.0, 400.0, 2000.0)
    for found, expected in zip(
        picked(stored, sos, 0.2, 7, 50), picked(whole.astype(float), sos, 0.2, 7, 50), strict=True
    ):
        assert np.array_equal(found, expected)


@pytest.mark.parametrize("channels", inputs([1, 3, 16], [3]))
@pytest.mark.parametrize("length", inputs([1, 2, 7], [2]))
@pytest.mark.parametrize("block", inputs([1, 3, 50], [3]))
def test_frames_are_those_of_plain_columns(channels, length, block):
    rows = RNG.integers(-2, 3, (4, channels, 50)).astype(float)
    rows[1], rows[3] = rows[1] ** 2, np.minimum(rows[2], rows[3])
    rows[2:, :, 20:] = np.repeat(rows[2:, :, 20:25], 6, axis=2)  # stands still again and again
    rows[3] = np.where(RNG.random((channels, 50)) < 0.7, rows[2], rows[3])
    frame = SignalFrames(channels, length)
    found = [frame.add(*rows[:, :, start : start + block]) for start in range(0, 50, block)]
    whole = np.concatenate([*found, frame.flush()], axis=1)
    for c, index in np.ndindex(whole.shape[:2]):
        columns = rows[:, c, index * length : (index + 1) * length].T.tolist()
        assert whole[c, index].tolist() == list(frame_of([tuple(x) for x in columns]))


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize(
    ("window", "transform"), inputs([(60, 60), (90, 200), (7, 9), (1, 2)], [(7, 9)])
)
@pytest.mark.parametrize("mean_removed", [False, True])
def test_power_is_that_of_plain_sums_of_waves(kind, window, transform, mean_removed):
    taper, samples = np.hanning(window + 2)[1:-1], RNG.normal(size=(2, 4 * window))
    found = WindowPower(taper, transform, mean_removed=mean_removed, kind=kind)(
        samples, 1, window, 3
    )
    for channel, index, k in np.ndindex(found.shape):
        own = samples[channel, 1 + index * window :][:window]
        own = (own - (own.mean() if mean_removed else 0.0)) * taper
        angle = 2 * math.pi * k / transform * np.arange(window)
        expected = math.fsum(own * np.cos(angle)) ** 2 + math.fsum(own * np.sin(angle)) ** 2
        tolerance = (1e-5 if kind is np.float32 else 1e-12) * window
        assert found[channel, index, k] == pytest.approx(expected, rel=tolerance, abs=tolerance)


@pytest.mark.filterwarnings("ignore:.*encountered in:RuntimeWarning")
@pytest.mark.parametrize("channels", CHANNELS)
def test_levels_are_the_moving_average_that_cells_have(channels):
    for name, x in signals(40, channels).items():
        before, levels = RNG.random(channels), np.empty(x.shape)
        picker.variance_levels(x, 0.3, before, levels)
        for c in range(channels):
            level, expected = before[c], []
            for y in x[:, c].tolist():
                level = 0.3 * (y * y) + 0.7 * level
                expected.append(level)
            assert np.array_equal(levels[:, c], expected, equal_nan=True), name


def hostile(rows: int, n: int) -> np.ndarray:
    """Return lines of few values, so that many are equal, infinities among them."""
    line = RNG.integers(0, 6, (rows, n)).astype(float)
    line[RNG.random((rows, n)) < 0.05] = np.inf
    line[RNG.random((rows, n)) < 0.05] = -np.inf
    return line


@pytest.mark.parametrize("history", inputs([1, 2, 7], [3]))
@pytest.mark.parametrize("block", inputs([1, 4, 60], [4]))
def test_the_trace_has_the_quietest_of_the_last_frames_that_are_not_dead(history, block):
    decision, signal = RNG.random((3, 60)), RNG.integers(0, 9, (3, 60, 4)).astype(float)
    signal[1, 5:30] = 0.0
    past, least = np.full((2, 3, history), np.inf), np.full((2, 3), np.inf)
    found = np.empty((60, 3, 6), np.float32)
    for start in range(0, 60, block):
        part = slice(start, start + block)
        own, values = np.ascontiguousarray(signal[:, part]), found[part]
        frames.trace_values(decision[:, part], own, past, least, start, 20.0, values)
    for i, c in np.ndindex(60, 3):
        levels, swings = signal[c, max(0, i - history + 1) : i + 1, 1:3].T.tolist()
        noise, quiet = (min([x for x in v if x > 0], default=0.0) for v in (levels, swings))
        peak, _, swing, still = signal[c, i]
        expected = np.array([decision[c, i], peak, noise, swing, quiet, still / 20.0], np.float32)
        assert np.array_equal(found[i, c], expected)


@pytest.mark.parametrize("width", inputs([1, 2, 3, 8, 30], [1, 3]))
def test_a_window_has_the_maximum_of_its_numbers_and_none_where_one_is_none(width):
    line = hostile(3, 70)
    line[1, 40] = np.nan
    found = maxima.window_maxima(line, width)
    windows = [[row[k : k + width] for k in range(70 - width + 1)] for row in line.tolist()]
    expected = [[math.nan if any(map(math.isnan, w)) else max(w) for w in row] for row in windows]
    assert np.array_equal(found, expected, equal_nan=True)


@pytest.mark.filterwarnings("ignore:.*encountered in:RuntimeWarning")
def test_a_ratio_to_noise_is_nothing_where_noise_is_silent():
    level, noise, trust = RNG.random((3, 40)), RNG.random((3, 44)), RNG.random(40)
    noise[:, 10:20] = (0.0, 1e-141, TINY, 1e-140, 1.1e-140, 1.0, np.inf, np.nan, 1e300, 1e-300)
    ratio = np.empty(level.shape)
    picker.ratio_to_noise(level, noise, trust, 1e-140, ratio)
    for r, i in np.ndindex(ratio.shape):
        own = noise[r, i]
        assert ratio[r, i] == (level[r, i] / own * trust[i] if own > 1e-140 else 0.0)


@pytest.mark.parametrize("reach", inputs([1, 2, 5], [2]))
@pytest.mark.parametrize("back", inputs([0, 1, 9], [9]))
def test_maxima_are_the_first_largest_within_their_reach_and_rise_over_the_floor(reach, back):
    line, keep, floor = hostile(4, 120), max(reach, back), 1.0
    found = picker.local_maxima(line, keep, 120 - reach, reach, floor, back)
    expected = []
    for i in range(keep, 120 - reach):
        for r, row in enumerate(line.tolist()):
            before, after = row[i - reach : i], row[i + 1 : i + 1 + reach]
            if not (row[i] > floor and max(before) < row[i] >= max(after)):
                continue
            begin = i
            while begin > i - back and row[begin - 1] > floor:
                begin -= 1
            expected.append((begin, i, r))
    assert found.T.tolist() == [list(each) for each in expected]


def onset_of(window: list[float], correlation: float) -> tuple[float, float]:
    """Return onset and deviation by Akaike weights of Maeda's criterion, in plain steps."""
    n = len(window)
    if n < 2 * picker.EDGE + 3:
        return n / 2, n / math.sqrt(12.0)
    x = [v - window[0] for v in window]

    def variance(part: list[float]) -> float:
        mean = math.fsum(part) / len(part)
        return math.fsum((v - mean) ** 2 for v in part) / len(part)

    pairs = [(variance(x[:k]), variance(x[k:])) for k in range(1, n)]
    least = max(picker.LEAST_PART * max(after for _, after in pairs), picker.LEAST)
    criterion = [
        k * math.log(before + least) + (n - k) * math.log(after + least)
        for k, (before, after) in enumerate(pairs, 1)
    ]
    inner = range(1 + picker.EDGE, n - picker.EDGE)
    lowest = min(criterion[k - 1] for k in inner)
    scale = 1.0 / (2.0 * max(correlation, 1.0))
    weights = [math.exp(-scale * (criterion[k - 1] - lowest)) for k in inner]
    mass = math.fsum(weights)
    onset = math.fsum(w * k for w, k in zip(weights, inner, strict=True)) / mass
    spread = math.fsum(w * (k - onset) ** 2 for w, k in zip(weights, inner, strict=True))
    return onset, math.sqrt(spread / mass)


@pytest.mark.parametrize("channels", CHANNELS)
@pytest.mark.parametrize("correlation", [0.0, 4.0])
def test_onsets_are_those_of_plain_steps(channels, correlation):
    n = 90
    x = RNG.normal(size=(n, channels)) * np.where(np.arange(n) < 50, 1.0, 8.0)[:, None]
    x[:, 0] = np.where(np.arange(n) < 50, 0.0, x[:, 0])
    channel = np.arange(channels)
    for start, length in ((0, 90), (13, 60), (40, 9), (3, 8), (5, 1)):
        window = (np.full(channels, start), np.full(channels, length), channel)
        found = picker.onsets(x, *window, correlation)
        expected = [onset_of(x[start : start + length, c].tolist(), correlation) for c in channel]
        assert np.allclose(found.T, expected, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("rate_hz", inputs([6.0, 50.0, 128.0], [50.0]))
def test_points_of_the_grid_are_weighted_means_of_the_samples_around(channels, rate_hz):
    at_s = np.linspace(0.0, 0.5, 200)
    table, reach, n = np.exp(-((at_s / 0.1) ** 2)), int(np.ceil(0.5 * rate_hz)), int(4 * rate_hz)
    values, step, first = RNG.normal(size=(channels, n)), rate_hz / 40.0, 5
    start, end = math.ceil(first / step), int((first + n - 1) / step)
    grid_of = (values, first, start, end, step, rate_hz, reach, at_s, table)
    low, recorded, own, past = grid.grid_points(*grid_of)
    for m in range(start, end):
        place = m * step - first
        k = np.arange(max(0, own[m - start] - reach), min(n, own[m - start] + reach + 1))
        weight = np.interp(np.abs(k - place) / rate_hz, at_s, table)
        expected = values[:, k] @ weight / weight.sum()
        assert np.allclose(low[:, m - start], expected, rtol=1e-9, atol=1e-9)
        assert own[m - start] + past[m - start] == pytest.approx(place, abs=1e-8)
        line = [np.interp(place, np.arange(n), row) for row in values]
        assert np.allclose(recorded[:, m - start], line, atol=1e-8)


@pytest.mark.parametrize("taps", [1, 5, 40])
def test_weighted_sums_are_a_convolution(taps):
    x, kernel = RNG.normal(size=(3, 70)), RNG.normal(size=taps)
    expected = [np.convolve(row, kernel, "valid") for row in x]
    assert np.allclose(grid.weighted_sums(x, kernel), expected, rtol=1e-12, atol=1e-12)
    assert grid.weighted_sums(x[:, : taps - 1].copy(), kernel).shape == (3, 0)


def loss_at(u: np.ndarray, t: np.ndarray, slope: float, threshold: float, passes: int) -> float:
    """Fit a line by reweighting and return the mean of twice Huber's loss, of one node."""
    weight, k, moment = np.ones(len(t)), 0.0, 0.0
    for index in range(passes + 1):
        if index:
            weight = threshold / np.maximum(np.abs(t - k * u - moment), threshold)
        total = weight.sum()
        u_mean, t_mean = (weight * u).sum() / total, (weight * t).sum() / total
        k = slope
        if np.isnan(slope):
            square = max((weight * (u - u_mean) ** 2).sum(), locate.TINY)
            k = max((weight * (u - u_mean) * (t - t_mean)).sum() / square, 0.0)
        moment = t_mean - k * u_mean
    size = np.abs(t - k * u - moment)
    inner = np.minimum(size, threshold)
    return float((inner * (2 * size - inner)).mean())


@pytest.mark.parametrize("nodes", inputs([1, 3, 64, 65, 130], [65]))
@pytest.mark.parametrize("sensors", inputs([3, 8, 17], [3]))
@pytest.mark.parametrize("slope", [math.nan, 0.002])
def test_losses_are_those_of_a_line_fitted_at_each_node(nodes, sensors, slope):
    times = 0.01 * RNG.random((2, sensors))
    for own in (1, 2):
        u, found = 5 * RNG.random((own, sensors, nodes)), np.empty((2, nodes))
        locate.robust_losses(u, times, slope, 1e-3, 2, found)
        for row, index in np.ndindex(found.shape):
            expected = loss_at(u[row % own, :, index], times[row], slope, 1e-3, 2)
            assert found[row, index] == pytest.approx(expected, rel=1e-6)
