"""The trace: frames of 50 ms, the same whatever the blocks."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from replay_blocks import cuts_of, parts_of

from groundtrace.detectors.trace import FRAME_S, FrameTrace, trace_of
from groundtrace_codecs.events import Quantity

RATE_HZ = 200.0
N = 260  # 26 frames of 10 columns
RNG = np.random.default_rng(9)
DECISION = RNG.normal(size=(2, N))
FILTERED = RNG.normal(size=(2, N))
RECORDED = np.round(RNG.normal(size=(2, N)), 1)
ROWS = (DECISION, np.abs(FILTERED), FILTERED**2, RECORDED, RECORDED)
TIMES = 1_000 + np.arange(N, dtype=np.int64) * 5_000_000
NAMES = [q.name for q in trace_of(Quantity("ratio", "1"), "m", "m")]


def run(cuts=(), rows=ROWS, rate_hz=RATE_HZ):
    trace = FrameTrace(rate_hz, len(rows[0]))
    length = rows[0].shape[1]
    pieces = zip(parts_of(TIMES[:length], cuts), *(parts_of(r, cuts) for r in rows), strict=True)
    frames = [trace.add(*piece) for piece in pieces] + [trace.flush()]
    return np.concatenate([f.time_ns for f in frames]), np.concatenate([f.value for f in frames])


def column(name: str, value: np.ndarray) -> np.ndarray:
    """Shape (n_channels, n_frames)."""
    return value[:, :, NAMES.index(name)].T


@given(cuts=cuts_of(N))
def test_parts_give_exactly_the_frames_of_the_whole(cuts):
    (times, value), (whole_times, whole) = run(cuts), run()
    assert np.array_equal(times, whole_times)
    assert np.array_equal(value, whole)


def test_frames_begin_every_fifty_milliseconds():
    times, value = run()
    assert np.array_equal(times, TIMES[::10])
    assert (np.diff(times) == round(FRAME_S * 1e9)).all()
    assert value.shape == (26, 2, len(NAMES))
    assert value.dtype == np.float32


def test_a_frame_holds_what_was_reached_in_it():
    _, value = run()
    folded = {n: r.reshape(2, 26, 10) for n, r in zip(("d", "p", "m", "r"), ROWS, strict=False)}
    assert np.array_equal(column("ratio", value), folded["d"].max(axis=2).astype(np.float32))
    assert np.array_equal(column("peak", value), folded["p"].max(axis=2).astype(np.float32))
    swing = np.ptp(folded["r"], axis=2) / 2
    assert np.allclose(column("swing", value), swing)
    rms = np.sqrt(folded["m"].mean(axis=2))
    assert np.allclose(column("noise", value), np.minimum.accumulate(rms, axis=1))
    assert np.allclose(column("quiet", value), np.minimum.accumulate(swing, axis=1))


def test_the_noise_is_the_quietest_frame_of_the_last_five_seconds():
    rate_hz, frames = 20.0, 220  # one column a frame
    power = np.full((1, frames), 4.0)
    power[0, 50] = 1.0
    zero = np.zeros((1, frames))
    trace = FrameTrace(rate_hz, 1)
    times = np.arange(frames, dtype=np.int64)
    value = trace.add(times, zero, zero, power, zero, zero).value
    noise = value[:, 0, NAMES.index("noise")]
    assert (noise[:50] == 2).all()
    assert (noise[50:150] == 1).all()
    assert (noise[150:] == 2).all()


def test_a_clipped_signal_stands_still_at_its_extreme():
    rows = [np.zeros((2, 10)) for _ in range(5)]
    wave = np.sin(np.arange(10.0) * 0.7)
    rows[3] = rows[4] = np.stack([np.clip(wave, -0.5, 0.5), wave])
    _, value = run((), rows)
    same = np.diff(rows[3][0]) == 0
    assert column("flat", value)[0, 0] == pytest.approx(same.sum() / RATE_HZ)
    assert column("flat", value)[1, 0] == 0.0


def test_the_last_frame_may_be_shorter():
    rows = tuple(r[:, :23] for r in ROWS)
    times, value = run((), rows)
    assert np.array_equal(times, TIMES[[0, 10, 20]])
    assert column("ratio", value)[0, 2] == np.float32(DECISION[0, 20:23].max())


def test_a_run_without_columns_has_no_frames():
    trace = FrameTrace(RATE_HZ, 3)
    frames = trace.flush()
    assert frames.time_ns.shape == (0,)
    assert frames.value.shape == (0, 3, len(NAMES))


@pytest.mark.parametrize("rate_hz", [6.0, 20.0])
def test_below_twenty_hertz_every_column_is_a_frame(rate_hz):
    times, _ = run((), rate_hz=rate_hz)
    assert np.array_equal(times, TIMES)
