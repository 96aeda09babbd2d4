"""Arrivals by correlating all pairs: delays of waves known, and what contradicts itself refused."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from groundtrace.localizers.array_method import Window
from groundtrace.localizers.gcc_phat import (
    CLOSURE,
    COLUMNS,
    HEIGHT,
    MISCLOSURE,
    ONSET,
    POWER,
    REFERENCE_HZ,
    REVERSED,
    SHIFT,
    Delays,
    GccPhat,
    consistent,
)
from groundtrace.pipeline.gates import Candidates, decide
from groundtrace.pipeline.parameters import describe
from groundtrace_codecs.geometry import Geometry, Sensor
from groundtrace_codecs.signals import NS_PER_S, Channel, Stream

BEFORE_S, AFTER_S, STEP_NS = 0.02, 0.05, 1_700_000_000 * NS_PER_S
PLACES = np.array([(x, y) for y in (0.0, 3.0, 6.0) for x in (0.0, 3.0, 6.0)])
NAMES = tuple(f"G{i}" for i in range(1, 10))
SITE = Geometry(tuple(Sensor(n, n, *p) for n, p in zip(NAMES, PLACES.tolist(), strict=True)))
SLAB_M2S = 183.0


def made_stream(rate_hz: float) -> Stream:
    return Stream("/s", tuple(Channel(n, "ground_velocity", "m/s") for n in NAMES), rate_hz)


def method(rate_hz: float = 20_000.0, **given: Any) -> GccPhat:
    made = GccPhat(GccPhat.Parameters(before_s=BEFORE_S, after_s=AFTER_S, **given))
    assert made.prepare(made_stream(rate_hz), SITE) == NAMES
    return made


def waves(
    distance_m: np.ndarray, rate_hz: float = 20_000.0, *, slab: bool = True, at_s: float = 0.0
) -> np.ndarray:
    """A pulse of 30 to 700 Hz after so many metres, shape (n, n_channels): unit peak at 3 m."""
    n = round((BEFORE_S + AFTER_S) * rate_hz)
    frequency = np.fft.rfftfreq(8 * n, 1 / rate_hz)
    omega = 2 * np.pi * frequency
    top = min(700.0, 0.4 * rate_hz)
    band = np.clip((frequency - 15) / 30, 0, 1) * np.clip((top - frequency) / 100, 0, 1)
    turn = np.sqrt(omega / SLAB_M2S) if slab else omega / 1000.0
    phase = np.multiply.outer(distance_m, turn) + omega * (BEFORE_S + at_s)
    traces = np.fft.irfft(band * np.exp(-1j * phase), axis=1)[:, :n]
    return (traces / np.abs(traces).max(axis=1, keepdims=True) * np.sqrt(3 / distance_m)[:, None]).T


def window(
    values: np.ndarray, distance_m: np.ndarray, rate_hz: float = 20_000.0, snr: float = 50.0
) -> Window:
    """The waveforms in noise, onsets picked late by up to 0.5 ms."""
    rng = np.random.default_rng(1)
    noisy = values + rng.standard_normal(values.shape) / snr
    picked = distance_m / 1500.0 + rng.uniform(0, 5e-4, len(distance_m))
    picked = picked - picked.min() + BEFORE_S
    return Window(STEP_NS, STEP_NS - round(BEFORE_S * NS_PER_S), rate_hz, noisy, picked)


def away(x: float, y: float) -> np.ndarray:
    return np.hypot(*(PLACES - (x, y)).T)


def examined(made: GccPhat, given: Window) -> Candidates:
    """What a step is found to be, measured and then learnt from."""
    return made.examine(made.measure(given))


def arrivals(made: GccPhat, found: Candidates) -> np.ndarray:
    """Accepted arrivals [s], NaN where a channel has none; none has two."""
    decisions, _ = decide(found, COLUMNS, made.gates, made.parameters)
    times = np.full(len(NAMES), np.nan)
    for row in np.flatnonzero(decisions.accepted):
        assert np.isnan(times[found.channel[row]])
        times[found.channel[row]] = (found.time_ns[row] - STEP_NS) / NS_PER_S
    return times


def fitted(times: np.ndarray, distance_m: np.ndarray) -> float:
    """What arrivals are off the best line over distance, in metres (rms)."""
    slope, offset = np.polyfit(distance_m, times, 1)
    return float(np.sqrt(np.mean((times - offset - slope * distance_m) ** 2)) / slope)


@pytest.mark.parametrize("rate_hz", [2_000.0, 4_000.0, 20_000.0])
@pytest.mark.parametrize(("slab", "power"), [(True, 0.5), (False, 1.0)])
def test_arrivals_grow_with_distance_whether_waves_disperse_or_not(
    rate_hz: float, slab: bool, power: float
) -> None:
    distance = away(1.3, 4.1)
    made = method(rate_hz, dispersion=power)
    found = examined(made, window(waves(distance, rate_hz, slab=slab), distance, rate_hz))
    times = arrivals(made, found)
    assert np.isfinite(times).all()
    assert times.min() >= 0.0
    assert fitted(times, distance) < 0.05
    assert (np.diff(found.time_ns) >= 0).all()


def test_without_dispersion_delays_are_those_of_the_waves() -> None:
    distance = away(1.3, 4.1)
    made = method(dispersion=1.0)
    clean = window(waves(distance, slab=False), distance, snr=1e4)
    times = arrivals(made, examined(made, clean))
    # a fifth of a sample
    assert times - times.min() == pytest.approx((distance - distance.min()) / 1000.0, abs=1e-5)


def test_a_channel_that_no_onset_was_picked_at_gains_an_arrival() -> None:
    distance = away(1.3, 4.1)
    given = window(waves(distance), distance)
    given.arrivals_s[[2, 5]] = np.nan
    made = method()
    times = arrivals(made, examined(made, given))
    assert np.isfinite(times).all()
    assert fitted(times, distance) < 0.05


def test_a_dead_channel_and_one_of_noise_alone_get_none() -> None:
    distance = away(1.3, 4.1)
    values = waves(distance)
    values[:, 4] = 0.0
    given = window(values, distance)
    given.values[:, 7] = 0.0
    given.arrivals_s[[4, 7]] = np.nan
    made = method()
    times = arrivals(made, examined(made, given))
    assert np.flatnonzero(np.isnan(times)).tolist() == [4, 7]
    assert fitted(times[np.isfinite(times)], distance[np.isfinite(times)]) < 0.05


def test_where_nothing_agrees_the_onsets_go_out_as_they_came() -> None:
    distance = away(1.3, 4.1)
    noise = np.random.default_rng(2).standard_normal((1400, 9)) * np.linspace(0.1, 5, 1400)[:, None]
    given = window(noise, distance)
    made = method()
    found = examined(made, given)
    decisions, _ = decide(found, COLUMNS, made.gates, made.parameters)
    assert (found.value[decisions.accepted, ONSET] == 1).all()
    assert arrivals(made, found) == pytest.approx(given.arrivals_s - BEFORE_S, abs=1e-9)


def test_two_walkers_at_once_contradict_each_other_more_than_one() -> None:
    one, other = away(1.3, 4.1), away(5.0, 1.0)
    alone = examined(method(), window(waves(one), one))
    both = examined(method(), window(waves(one) + 0.9 * waves(other, at_s=0.004), one))
    height, closure = (
        [float(np.median(f.value[f.value[:, ONSET] == 0, c])) for f in (alone, both)]
        for c in (HEIGHT, CLOSURE)
    )
    assert height[1] < 0.8 * height[0]
    assert closure[1] > 5 * closure[0]


def test_gates_tell_by_how_much_and_onsets_give_way_to_what_stands() -> None:
    distance = away(1.3, 4.1)
    made = method()
    found = examined(made, window(waves(distance), distance))
    decisions, _ = decide(found, COLUMNS, made.gates, made.parameters)
    onset = found.value[:, ONSET] == 1
    assert onset.sum() == len(NAMES)
    assert decisions.accepted.tolist() == (~onset).tolist()
    assert np.isinf(decisions.gate_value[onset, :5]).all()
    shift = np.abs(found.value[~onset, SHIFT]).max()
    assert (decisions.gate_value[onset, 5] <= shift + 1e-6).all()
    strict = method(min_height=0.99)
    decisions, _ = decide(found, COLUMNS, strict.gates, strict.parameters)
    assert decisions.accepted.tolist() == onset.tolist()
    assert {g.parameter for g in made.gates} <= {i.name for i in describe(made.Parameters)}


def test_pairs_locked_on_to_an_echo_hardly_move_the_arrivals() -> None:
    true = np.array([0.0, 1e-3, 2e-3, 4e-3, 5e-3])
    first, second = np.triu_indices(5, 1)
    delay = true[first] - true[second]
    delay[[1, 6]] += 8e-3
    found, misfit = consistent(Delays(first, second, delay, np.ones(10), np.ones(10)), 5)
    assert found == pytest.approx(true - true.mean(), abs=1e-4)
    assert np.flatnonzero(np.abs(misfit) > 1e-3).tolist() == [1, 6]


def test_an_array_of_two_is_not_enough() -> None:
    stream = Stream("/s", tuple(Channel(n, "seismic", "count") for n in NAMES[:2]), 1000.0)
    assert GccPhat(GccPhat.Parameters()).prepare(stream, Geometry()) == ()
    assert REFERENCE_HZ == 100.0


@pytest.mark.parametrize("rate_hz", [2_000.0, 20_000.0])
def test_clocks_that_are_known_to_be_off_do_not_show_but_in_the_times(rate_hz: float) -> None:
    distance = away(1.3, 4.1)
    ahead = np.random.default_rng(3).normal(0, 0.003, 9)
    moved = np.rint(ahead * rate_hz) / rate_hz
    # the stage moves by whole samples: what is left shows in the samples
    late = np.array([waves(distance, rate_hz, at_s=s)[:, c] for c, s in enumerate(ahead - moved)]).T
    sensors = tuple(replace(s, clock_offset_s=x) for s, x in zip(SITE.sensors, ahead, strict=True))
    made = method(rate_hz)
    made.prepare(made_stream(rate_hz), Geometry(sensors))
    times = arrivals(made, examined(made, window(late, distance, rate_hz)))
    assert times.min() >= 0.0
    assert fitted(times - ahead, distance) < 0.05


def test_of_three_axes_at_one_place_the_vertical_is_compared() -> None:
    sensors = tuple(
        Sensor(f"{s.name}{axis}", f"{s.name}{axis}", s.x, s.y, axis=axis)
        for s in SITE.sensors
        for axis in "xyz"
    )
    names = [s.channel for s in sensors]
    stream = Stream("/s", tuple(Channel(n, "ground_velocity", "m/s") for n in names), 20_000.0)
    made = GccPhat(GccPhat.Parameters(before_s=BEFORE_S, after_s=AFTER_S))
    assert made.prepare(stream, Geometry(sensors)) == tuple(names)
    distance = away(1.3, 4.1)
    three = window(np.repeat(waves(distance), 3, axis=1), np.repeat(distance, 3))
    found = examined(made, three)
    compared = {names[c] for c in found.channel[found.value[:, ONSET] == 0]}
    assert compared == {name for name in names if name.endswith("z")}


@pytest.mark.parametrize(("slab", "power"), [(True, 0.5), (False, 1.0)])
def test_the_law_whose_delays_close_is_taken_without_being_told(slab: bool, power: float) -> None:
    made, distance = method(), away(1.3, 4.1)
    for number in range(3):
        found = examined(made, window(waves(distance, slab=slab, at_s=1e-3 * number), distance))
        row = found.value[:, ONSET] == 0
        assert set(found.value[row, POWER].tolist()) == {power}
        assert fitted(arrivals(made, found), distance) < 0.05


def test_delays_that_do_not_close_leave_the_onsets_and_are_told_once() -> None:
    made, rng, distance = method(), np.random.default_rng(3), away(1.3, 4.1)
    made._stage, made._topic = "arrivals", "/s"
    told = []
    for _ in range(12):
        # every channel has a wave of its own
        noise = rng.standard_normal(waves(distance).shape)
        envelope = np.exp(-np.arange(len(noise)) / 400)[::-1, None]
        given = window(envelope * noise, distance)
        found = examined(made, given)
        onset = found.value[:, ONSET] == 1
        decisions, _ = decide(found, COLUMNS, made.gates, made.parameters)
        assert found.value[~onset, MISCLOSURE].min() > made.parameters.max_misclosure_s
        assert decisions.accepted.tolist() == onset.tolist()
        told += list(made.remarks(STEP_NS))
    (note,) = told
    assert "the delays of pairs contradict each other" in note.text
    assert "onsets instead in 8 of 8 steps" in note.text


def test_delays_that_reverse_what_onsets_say_leave_the_onsets_and_are_told_once() -> None:
    """A floor that rings as a whole: the far sensors move no later than those beside the step."""
    made, near, far = method(), away(0.0, 0.2), away(6.0, 5.8)
    made._stage, made._topic = "arrivals", "/s"
    told, reversed_ = [], []
    for _ in range(6):
        heard = window(waves(far), far)
        # picked where they are: a millisecond per metre
        picked = BEFORE_S + (near - near.min()) / 1000.0
        found = examined(made, replace(heard, arrivals_s=picked))
        onset = found.value[:, ONSET] == 1
        decisions, _ = decide(found, COLUMNS, made.gates, made.parameters)
        reversed_.append(float(found.value[~onset, REVERSED].max()))
        assert decisions.accepted.tolist() == onset.tolist()
        told += list(made.remarks(STEP_NS))
    assert min(reversed_) > 0.9
    (note,) = told
    assert "reverse the order of" in note.text
    assert "arrivals gives onsets instead" in note.text


def test_few_pairs_of_onsets_tell_no_order() -> None:
    made, near, far = method(), away(0.0, 0.2), away(6.0, 5.8)
    picked = np.full(len(NAMES), np.nan)
    picked[[0, 4, 8]] = BEFORE_S + (near[[0, 4, 8]] - near[0]) / 1000.0
    found = examined(made, replace(window(waves(far), far), arrivals_s=picked))
    assert set(found.value[found.value[:, ONSET] == 0, REVERSED].tolist()) == {0.0}


def test_onsets_that_agree_with_the_delays_are_not_called_reversed() -> None:
    made, distance = method(), away(1.3, 4.1)
    for _ in range(4):
        picked = BEFORE_S + (distance - distance.min()) / 500.0
        found = examined(made, replace(window(waves(distance), distance), arrivals_s=picked))
    assert set(found.value[found.value[:, ONSET] == 0, REVERSED].tolist()) == {0.0}
    assert not list(made.remarks(STEP_NS))


def test_a_step_whose_order_is_reversed_throughout_is_judged_by_itself() -> None:
    made, distance, near = method(), away(1.3, 4.1), away(0.0, 0.2)
    for _ in range(8):
        picked = BEFORE_S + (distance - distance.min()) / 500.0
        examined(made, replace(window(waves(distance), distance), arrivals_s=picked))
    far = away(6.0, 5.8)
    picked = BEFORE_S + np.round((near - near.min()) / 4.0) * 4e-3  # the same or clearly apart
    found = examined(made, replace(window(waves(far), far), arrivals_s=picked))
    assert set(found.value[found.value[:, ONSET] == 0, REVERSED].tolist()) == {1.0}
    assert not list(made.remarks(STEP_NS))  # the floor is not judged by one step
