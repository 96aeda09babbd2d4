"""TOA-CV in plain steps over a whole run: slow, and what the compiled picker must agree with."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy import signal

from groundtrace.dsp.filters import bandpass

if TYPE_CHECKING:
    from groundtrace.detectors.variance_change import VarianceChangeParameters
    from groundtrace_codecs.signals import SignalBlock

CELL_S, FRAME_CELLS, QUIET_FRAMES = 0.001, 50, 100
BEFORE_S, AFTER_S = 0.010, 0.005
SILENCE = 1e-140


@dataclass(frozen=True, slots=True, eq=False)
class Slow:
    """Candidates by (time, channel), and frames, as the picker has them."""

    time_ns: np.ndarray
    channel: np.ndarray
    value: np.ndarray
    frames: np.ndarray


def slow_toa_cv(block: SignalBlock, p: VarianceChangeParameters) -> Slow:
    """Return what TOA-CV finds in a run that comes in one block."""
    rate = block.stream.rate_hz
    recorded = block.values.T
    sos = bandpass(p.low_hz, p.high_hz, rate)
    steady = signal.sosfilt_zi(sos)[:, None, :] * recorded[None, :, :1]
    band = signal.sosfilt(sos, recorded, axis=1, zi=steady)[0]
    alpha = -np.expm1(-np.log(10) / (p.memory_s * rate))
    level = signal.lfilter([alpha], [1.0, alpha - 1.0], band**2, axis=1)
    length = max(1, round(CELL_S * rate))

    def cells(x: np.ndarray) -> np.ndarray:
        count = x.shape[1] // length
        return x[:, : count * length].reshape(len(x), count, length)

    ratio = _ratio(cells(level).max(axis=2), p, length / rate)
    rises = _rises(ratio, p, length / rate)
    frames = _frames(ratio, cells(band), cells(recorded), length / rate)
    times = block.sample_times()
    rows = [_candidate(band[c], begin * length, rate) for begin, _, c in rises]
    whole = np.floor([onset for onset, _ in rows]).astype(int)
    past = np.array([onset for onset, _ in rows]) - whole
    time_ns = times[whole] + np.rint(past * 1e9 / rate).astype(np.int64)
    channel = np.array([c for _, _, c in rises])
    value = np.array([(ratio[c, peak], d / rate) for (_, peak, c), (_, d) in zip(rises, rows)])  # noqa: B905
    order = np.lexsort((channel, time_ns))
    return Slow(time_ns[order], channel[order], value[order].astype(np.float32), frames)


def _ratio(level: np.ndarray, p: VarianceChangeParameters, cell_s: float) -> np.ndarray:
    noise_cells, gap = max(1, round(p.noise_s / cell_s)), max(1, round(p.gap_s / cell_s))
    padded = np.pad(level, ((0, 0), (noise_cells - 1, 0)))
    noise = sliding_window_view(padded, noise_cells, axis=1).max(axis=2)
    earlier = np.concatenate([np.repeat(noise[:, :1], gap, axis=1), noise], axis=1)
    known = np.maximum(np.arange(level.shape[1]) - gap + 1.0, 0.0)
    earlier = earlier[:, : level.shape[1]]
    heard = np.where(earlier > SILENCE, earlier, np.inf)
    return level / heard * (known / (known + p.warm_up_s / cell_s))


def _rises(
    ratio: np.ndarray, p: VarianceChangeParameters, cell_s: float
) -> list[tuple[int, int, int]]:
    """Begin, peak and channel of each rise, by walking over the cells."""
    reach, back = max(1, round(p.separation_s / cell_s)), round(p.gap_s / cell_s)
    found = []
    for channel, line in enumerate(ratio):
        for cell in np.flatnonzero(line > p.floor):
            before = line[max(0, cell - reach) : cell]
            after = line[cell + 1 : cell + 1 + reach]
            if (before >= line[cell]).any() or (after > line[cell]).any():
                continue
            begin = cell
            while begin > max(0, cell - back) and line[begin - 1] > p.floor:
                begin -= 1
            found.append((int(begin), int(cell), channel))
    return found


def _candidate(band: np.ndarray, anchor: int, rate: float) -> tuple[float, float]:
    """Onset and deviation [samples] by Maeda's criterion under Akaike weights."""
    start = max(0, anchor - round(BEFORE_S * rate))
    x = band[start : anchor + 1 + round(AFTER_S * rate)]
    n = len(x)
    if n < 9:
        return start + n / 2, n / np.sqrt(12)
    x = x - x[0]
    k = np.arange(1, n)
    total, square = np.cumsum(x), np.cumsum(x * x)
    before = square[:-1] / k - (total[:-1] / k) ** 2
    after = (square[-1] - square[:-1]) / (n - k) - ((total[-1] - total[:-1]) / (n - k)) ** 2
    least = 1e-8 * max(after.max(), 1e-300)
    aic = k * np.log(np.maximum(before, 0) + least)
    aic = (aic + (n - k) * np.log(np.maximum(after, 0) + least))[3:-3]
    weight = np.exp(-(aic - aic.min()) / 2)
    weight /= weight.sum()
    onset = (weight * k[3:-3]).sum()
    return start + onset, np.sqrt((weight * (k[3:-3] - onset) ** 2).sum())


def _frames(ratio: np.ndarray, band: np.ndarray, recorded: np.ndarray, cell_s: float) -> np.ndarray:
    """Shape (n_frames, n_channels, 6), the last one shorter."""
    length = max(1, round(FRAME_CELLS * CELL_S / cell_s))
    found = []
    for start in range(0, ratio.shape[1], length):
        part = slice(start, start + length)
        high, low = recorded[:, part].max(axis=2), recorded[:, part].min(axis=2)
        most, least = high.max(axis=1, keepdims=True), low.min(axis=1, keepdims=True)
        still = (high == low) & ((high == most) | (low == least))
        stood = (still[:, 1:] & still[:, :-1] & (high[:, 1:] == high[:, :-1])).sum(axis=1)
        rms = np.sqrt((band[:, part] ** 2).mean(axis=(1, 2)))
        swing = ((most - least) / 2)[:, 0]
        peak = np.abs(band[:, part]).max(axis=(1, 2))
        found.append([ratio[:, part].max(axis=1), peak, rms, swing, swing, stood * cell_s])
    frames = np.array(found).transpose(0, 2, 1)
    for quantity in (2, 4):  # the quietest of the last 5 s that is not dead
        own = frames[:, :, quantity].copy()
        own[own == 0] = np.inf
        quietest = [own[max(0, i - QUIET_FRAMES + 1) : i + 1].min(axis=0) for i in range(len(own))]
        frames[:, :, quantity] = np.where(np.isfinite(quietest), quietest, 0.0)
    return frames.astype(np.float32)
