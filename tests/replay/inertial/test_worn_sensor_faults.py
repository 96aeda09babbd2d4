"""Worn sensors that contradict themselves: told where planted, with the map that undoes it."""

from __future__ import annotations

import math
import pickle
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from sweeps import swept
from turning_sensors import RATE_HZ, turning_sensor

from groundtrace.detectors.clipping import Limits, Repeats
from groundtrace.detectors.signal_faults import Windows
from groundtrace.inertial.worn_sensor_faults import (
    RIVALS,
    AxisMap,
    ImuWatch,
    Spreads,
    judged,
    rival_of,
    rotations,
)
from groundtrace_codecs.events import Gap, Note
from groundtrace_codecs.signals import Channel, SignalBlock, Stream

if TYPE_CHECKING:
    from collections.abc import Iterator

    from groundtrace.detectors.signal_faults import Finding

GYRO, FORCE, FIELD = "angular_velocity", "acceleration", "magnetic_field"
UNITS = {GYRO: "rad/s", FORCE: "m/s2", FIELD: "T"}
EYE = np.eye(3)


def stream(*quantities: str, rate_hz: float = RATE_HZ, topic: str = "/imu") -> Stream:
    channels = tuple(
        Channel(f"{quantity}_{axis}", quantity, UNITS[quantity], axis)
        for quantity in quantities
        for axis in "xyz"
    )
    return Stream(topic, channels, rate_hz, "waist")


def blocks(of: Stream, samples: np.ndarray, cut: int = 500) -> Iterator[SignalBlock]:
    for first in range(0, len(samples), cut):
        yield SignalBlock(of, 10**12, first, samples[first : first + cut])


def found(samples: np.ndarray, *quantities: str, cut: int = 500) -> list[Finding]:
    of = stream(*(quantities or (GYRO, FORCE, FIELD)))
    watch = ImuWatch([of])
    for block in blocks(of, samples, cut):
        watch.update(block)
    watch.flush()
    return list(watch.findings())


def changed(samples: np.ndarray, place: int, matrix: np.ndarray) -> np.ndarray:
    samples = samples.copy()
    columns = slice(3 * place, 3 * place + 3)
    samples[:, columns] = samples[:, columns] @ matrix.T
    return samples


def test_a_sensor_in_order_gives_no_finding_and_says_that_its_axes_fit() -> None:
    of = stream(GYRO, FORCE, FIELD)
    watch = ImuWatch([of])
    for block in blocks(of, turning_sensor()):
        watch.update(block)
    watch.flush()
    assert list(watch.findings()) == []
    checks = list(watch.checks())
    assert [(c.against, c.worse) for c in checks] == [(FORCE, 47), (FIELD, 47)]
    assert all(c.text.startswith("the axes fit") for c in checks)


@pytest.mark.parametrize("place", swept(range(1, 48), *range(1, 48, 8)))
def test_any_signed_permutation_of_the_gyroscope_is_undone_by_the_map_that_is_named(
    place: int,
) -> None:
    (fault,) = found(changed(turning_sensor(40.0), 0, RIVALS[place]))
    undo = AxisMap(GYRO, RIVALS[place].T)
    assert fault.kind == "axes"
    assert fault.channel == GYRO
    assert undo.columns in fault.remedy


@pytest.mark.parametrize("quantity", [FORCE, FIELD])
@pytest.mark.parametrize(
    "matrix",
    [EYE[[1, 0, 2]], EYE[[0, 2, 1]], EYE[[2, 1, 0]], *(np.diag(1 - 2 * EYE[k]) for k in range(3))],
)
def test_the_third_vector_tells_that_it_is_not_the_gyroscope(
    quantity: str, matrix: np.ndarray
) -> None:
    place = (GYRO, FORCE, FIELD).index(quantity)
    of = stream(GYRO, FORCE, FIELD)
    watch = ImuWatch([of])
    for block in blocks(of, changed(turning_sensor(), place, matrix)):
        watch.update(block)
    watch.flush()
    (fault,) = watch.findings()
    assert fault.remedy == f"in the map, {AxisMap(quantity, matrix.T).columns}"
    other = FORCE if quantity == FIELD else FIELD
    assert fault.channel == quantity
    assert f"contradict {GYRO} and {other}:" in fault.what
    # nothing is wrong between the other two
    said = {check.against: check.text for check in watch.checks()}
    assert said[quantity].startswith("contradicted")
    assert said[other].startswith("the axes fit")


@pytest.mark.parametrize("place", [1, 2])
def test_a_sign_of_a_whole_vector_is_not_observable(place: int) -> None:
    assert found(changed(turning_sensor(), place, -EYE)) == []


@pytest.mark.parametrize("matrix", [np.diag([-1.0, 1, 1]), EYE[[1, 0, 2]]])
def test_a_left_handed_frame_of_all_three_vectors_is_told(matrix: np.ndarray) -> None:
    samples = turning_sensor()
    for place in range(3):
        samples = changed(samples, place, matrix)
    (fault,) = found(samples)
    assert "each axis gets scale = -1 (its frame is left-handed)" in fault.remedy


def test_without_a_field_both_sensors_that_may_be_meant_are_named_by_their_simplest_change() -> (
    None
):
    samples = turning_sensor()[:, :6]
    (fault,) = found(changed(samples, 1, np.diag([1.0, -1, 1])), GYRO, FORCE)
    assert 'acceleration: axis = "y" gets scale = -1' in fault.remedy
    (fault,) = found(changed(samples, 0, EYE[[1, 2, 0]]), GYRO, FORCE)
    assert f"{GYRO}: " in fault.remedy
    assert f"; or, which fits as well, {FORCE}: " in fault.remedy


@pytest.mark.parametrize(
    ("factor", "called", "was"),
    [(180 / math.pi, "rad/s", "deg/s"), (math.pi / 180, "deg/s", "rad/s")],
)
def test_a_unit_of_the_gyroscope_mistaken_for_the_other_is_told(
    factor: float, called: str, was: str
) -> None:
    (fault,) = found(changed(turning_sensor(100.0), 0, factor * EYE))
    assert fault.kind == "unit"
    assert f'unit = "{was}" where it is "{called}"' in fault.remedy


def test_a_field_of_zeros_is_told_once() -> None:
    of = stream(GYRO, FORCE, FIELD)
    watch = ImuWatch([of])
    for block in blocks(of, changed(turning_sensor(), 2, 0 * EYE)):
        watch.update(block)
    watch.flush()
    (fault,) = watch.findings()
    assert (fault.kind, fault.channel) == ("zero", FIELD)
    said = {check.against: check.text for check in watch.checks()}
    assert said[FIELD] == "not checked: it is zero in all samples"


@pytest.mark.parametrize("push_mps2", [1.0, 2.0, 4.0])
def test_a_foot_that_is_pushed_is_not_contradicted_by_what_leaves_nothing_of_gravity(
    push_mps2: float,
) -> None:
    # spun 57 times as fast, or about another axis, gravity and pushes average out, and their spread
    assert found(pushed_foot(push_mps2), GYRO, FORCE) == []


def pushed_foot(push_mps2: float) -> np.ndarray:
    """Return gyroscope and acceleration of a foot, pushed otherwise every two seconds."""
    random = np.random.default_rng(4)
    time_s = np.arange(10_000) / RATE_HZ
    stride = 2 * np.pi * 0.9 * time_s
    rate = np.stack(
        [
            0.8 * np.sin(2 * stride + 1) + 0.15 * np.sin(2 * np.pi * 0.05 * time_s),
            7 * np.sin(stride) + 2.1 * np.sin(2 * stride),
            0.6 * np.sin(stride + 2) + 0.3 * np.sin(2 * np.pi * 0.03 * time_s),
        ],
        axis=1,
    )
    step = np.zeros_like(rate)
    step[1:] = (rate[1:] + rate[:-1]) / (2 * RATE_HZ)
    pushes = np.repeat(random.normal(0, push_mps2, (51, 3)), 200, axis=0)[: len(time_s)]
    to_start = np.moveaxis(rotations(step), -1, 0)
    force = np.einsum("nki,nk->ni", to_start, pushes + np.array([0, 0, 9.81]))
    return np.hstack([rate, force + random.normal(0, 0.3, force.shape)])


def test_a_sensor_at_rest_with_a_biased_gyroscope_is_not_contradicted() -> None:
    random = np.random.default_rng(3)
    rest = random.normal(0, [0.002] * 3 + [0.02] * 3, (12_000, 6))
    rest += [0.05, -0.03, 0.02, 0.5, 9.7, -1.0]
    assert found(rest, GYRO, FORCE) == []


def test_an_upright_runner_whose_gyroscope_errs_by_more_than_it_turns_is_not_contradicted() -> None:
    rng, count = np.random.default_rng(2), round(100 * RATE_HZ)
    t = np.arange(count) / RATE_HZ
    bounce = 12.0 * np.sin(2 * np.pi * 2.6 * t)
    sway = np.repeat(rng.normal(0, 0.4, (count // 200 + 1, 3)), 200, axis=0)[:count]
    force = rng.normal(sway, 1.0) + np.stack([0 * t, 0 * t, 9.81 + bounce], axis=1)
    rate = rng.normal(0, 0.05, (count, 3))
    rate[:, 2] += 1.2 * np.sin(2 * np.pi * 1.3 * t)
    # impacts rectified: it errs by another part of each stride, about the axis to the side
    rate[:, 1] += np.repeat(rng.normal(0, 0.3, count // 100 + 1), 100)[:count]
    assert found(np.hstack([rate, force]), GYRO, FORCE) == []


@pytest.mark.parametrize("offset_radps", [0.05, 0.2])
def test_an_offset_of_the_gyroscope_is_no_reason_to_change_axes(offset_radps: float) -> None:
    samples = turning_sensor()
    samples[:, :3] += [offset_radps, 0, -offset_radps]
    assert found(samples) == []


def test_too_little_turning_is_said_to_be_too_little() -> None:
    of = stream(GYRO, FORCE)
    random = np.random.default_rng(3)
    watch = ImuWatch([of])
    samples = random.normal(0, [0.002] * 3 + [0.5] * 3, (6000, 6))
    samples[:, 5] += 9.8
    for block in blocks(of, samples):
        watch.update(block)
    watch.flush()
    (check,) = watch.checks()
    assert check.text.startswith("too little turning to confirm the axes")
    assert list(watch.findings()) == []


def test_iron_that_turns_with_the_sensor_judges_no_axes() -> None:
    samples = turning_sensor()
    samples[:, 6:] = samples[:, 6:] * 0.05 + [200e-6, 0, 90e-6]
    of = stream(GYRO, FORCE, FIELD)
    watch = ImuWatch([of])
    for block in blocks(of, samples):
        watch.update(block)
    watch.flush()
    assert list(watch.findings()) == []
    assert [c.text[:11] for c in watch.checks()] == ["the axes fi", "not checked"]


def phone_in_circles(iron_t: tuple[float, float, float]) -> np.ndarray:
    """A level phone, rocked a little, in circles to one side and then to the other."""
    random, t = np.random.default_rng(3), np.arange(60 * round(RATE_HZ)) / RATE_HZ
    heading = 0.9 * np.where(t < 30, t, 60 - t)
    rocking = np.stack([0.1 * np.sin(11 * t), 0.15 * np.sin(5.5 * t), 0 * t], axis=1)
    turns = Rotation.from_euler("z", heading[:, None]) * Rotation.from_rotvec(rocking)
    rate = (turns[:-1].inv() * turns[1:]).as_rotvec() * RATE_HZ
    rate = np.concatenate([rate, rate[-1:]])
    force = turns.inv().apply([0.0, 0.0, 9.81]) + random.normal(0, 0.5, (len(t), 3))
    field = turns.inv().apply([0.0, 2e-5, -4e-5]) + random.normal(0, 3e-7, (len(t), 3)) + iron_t
    return np.concatenate([rate, force, field], axis=1)


def test_iron_is_no_contradiction_of_axes(monkeypatch: pytest.MonkeyPatch) -> None:
    samples = phone_in_circles((3e-5, 0.0, 4e-5))
    watch = ImuWatch([stream(GYRO, FORCE, FIELD)])
    for block in blocks(stream(GYRO, FORCE, FIELD), samples):
        watch.update(block)
    watch.flush()
    assert list(watch.findings()) == []
    texts = [check.text for check in watch.checks()]
    assert texts[0].startswith("the axes fit")
    assert texts[1].startswith("not checked: 30, 0, 40 uT of it turn with the sensor")
    # without that explanation it would be one
    monkeypatch.setattr(Spreads, "iron", lambda _: None)
    assert [finding.kind for finding in watch.findings()] == ["axes"]


def test_axes_that_are_wrong_are_told_beside_what_looks_like_iron() -> None:
    """Exchanged with the vertical one, an axis has a constant part of the earth's field."""
    samples = changed(phone_in_circles((0.0, 0.0, 0.0)), 2, EYE[[2, 1, 0]])
    (finding,) = found(samples)
    assert finding.channel == FIELD
    assert "magnetic_field: " in finding.remedy


@settings(max_examples=5, deadline=None)
@given(st.integers(7, 3000))
def test_findings_do_not_depend_on_how_a_signal_is_cut(cut: int) -> None:
    samples = changed(turning_sensor(26.0), 0, EYE[[1, 0, 2]])
    assert found(samples, cut=cut) == found(samples, cut=3000)


def test_a_replay_warns_at_its_end() -> None:
    of = stream(GYRO, FORCE, FIELD)
    items = list(blocks(of, changed(turning_sensor(), 0, EYE[[1, 0, 2]])))
    (note,) = [x for x in judged(items, [of]) if isinstance(x, Note)]
    assert (note.level, note.source) == ("WARN", "health")
    assert 'axis = "x" becomes axis = "y"; axis = "y" becomes axis = "x"' in note.text


def test_acceleration_that_never_comes_is_not_waited_for_in_ever_more_memory() -> None:
    gyro, force = stream(GYRO, topic="/gyro"), stream(FORCE, topic="/acc")
    watch = ImuWatch([gyro, force])
    samples = turning_sensor(60.0)
    for block in blocks(gyro, samples[:, :3]):
        watch.update(block)
    assert len(pickle.dumps(watch)) < 100_000
    watch.flush()
    assert list(watch.findings()) == []


def test_two_sensors_of_one_placement_in_streams_of_their_own_are_not_mixed() -> None:
    streams = [stream(GYRO, topic="/a"), stream(FORCE, topic="/b"), stream(GYRO, topic="/c")]
    assert ImuWatch(streams).sensors == []


def test_an_hour_keeps_little_more_than_ten_minutes() -> None:
    rows = np.tile(turning_sensor(60.0)[:, :6], (10, 1))
    sizes = []
    spreads = Spreads(8.0, 4, scaled=True)
    for _ in range(6):
        spreads.update(rows, RATE_HZ, 10**12)
        sizes.append(len(spreads))
    assert sizes[-1] < 2 * sizes[0]


def test_rivals_are_the_48_signed_permutations_the_stated_one_first() -> None:
    assert len({tuple(m.ravel()) for m in RIVALS}) == 48
    assert rival_of(EYE) == 0


# tops that are cut off


def limits_of(values: np.ndarray, quantity: str = GYRO, rate_hz: float = 200.0) -> list[Finding]:
    units = {**UNITS, "ground_velocity": "m/s"}
    of = Stream("/s", (Channel("c", quantity, units[quantity], "y"),), rate_hz)
    windows, limits = Windows(rate_hz), Limits(of, {quantity})
    for block in blocks(of, values[:, None]):
        for window in windows.add(block):
            limits.update(window)
    for window in windows.flush():
        limits.update(window)
    return list(limits.findings())


def swinging(count: int = 8000, seed: int = 5) -> np.ndarray:
    """Return a gyroscope of a foot: swings of 8 to 12 rad/s, once a second."""
    random = np.random.default_rng(seed)
    time_s = np.arange(count) / 200.0
    height = np.repeat(random.uniform(8, 12, count // 200 + 1), 200)[:count]
    swing = height * np.sin(2 * np.pi * 2.5 * (time_s % 1.0)) * (time_s % 1.0 < 0.4)
    return swing + random.normal(0, 0.02, count)


def test_a_gyroscope_at_500_deg_per_s_is_told_behind_a_calibration_and_noise() -> None:
    limit = math.radians(500)
    random = np.random.default_rng(6)
    cut = 1.02 * np.clip(swinging(), -limit, limit) + 0.05 + random.normal(0, 0.01, 8000)
    (fault,) = limits_of(cut)
    assert fault.kind == "clipped"
    assert "near the full scale of 500 deg/s" in fault.what
    assert fault.events >= 10
    assert limits_of(swinging()) == []


def test_an_amplifier_whose_rails_differ_and_wander_is_told_on_both_sides() -> None:
    random = np.random.default_rng(7)
    time_s = np.arange(40_000) / 20_000.0
    burst = np.exp(-((time_s % 0.2) / 0.02)) * np.sin(2 * np.pi * 150 * time_s)
    loud = burst * 1e-4 * np.repeat(random.uniform(0.8, 1.2, 10), 4000)
    wander = np.repeat(random.uniform(0.98, 1.02, 100), 400)
    noise = random.normal(0, 1e-8, len(loud))
    rails = np.clip(loud, -3.2e-5 * wander + noise, 4e-5 * wander + noise)
    (fault,) = limits_of(rails, "ground_velocity", 20_000.0)
    assert fault.kind == "clipped"
    assert " and -0.00003" in fault.what
    assert limits_of(loud + noise, "ground_velocity", 20_000.0) == []


def test_gravity_at_rest_is_no_limit_of_the_side_that_it_leaves() -> None:
    random = np.random.default_rng(8)
    values = -9.81 + random.normal(0, 0.01, 4000)
    for at in range(300, 4000, 400):  # falls that end at rest
        values[at : at + 40] -= np.hanning(40) * 5
    assert limits_of(values, FORCE) == []


def repeats_of(values: np.ndarray, quantity: str = FORCE) -> list[Finding]:
    of = Stream("/s", (Channel("c", quantity, UNITS[quantity], "y"),), RATE_HZ)
    windows, repeats = Windows(RATE_HZ), Repeats(of)
    for block in blocks(of, values[:, None]):
        for window in windows.add(block):
            repeats.update(window)
    for window in windows.flush():
        repeats.update(window)
    return list(repeats.findings())


def struck(count: int = 6000, seed: int = 9) -> np.ndarray:
    """Return the acceleration of a heel that strikes once a second, for two samples."""
    random = np.random.default_rng(seed)
    values = -random.normal(0, 2, count).clip(-9, 9)
    strikes = np.arange(50, count, 100)
    values[strikes] += random.uniform(40, 200, len(strikes))
    values[strikes + 1] += random.uniform(40, 120, len(strikes))
    return values


def test_strikes_of_one_sample_at_the_limit_are_told() -> None:
    limit = 16 * 9.80665
    (fault,) = repeats_of(np.minimum(struck(), limit))
    assert (fault.kind, fault.events) == ("clipped", int((struck() > limit).sum()))
    assert "near the full scale of 16 g" in fault.what
    assert repeats_of(struck()) == []
    # and so by the watch that import and replay have
    of = stream(FORCE)
    watch = ImuWatch([of])
    strikes = np.minimum(np.stack([struck(seed=k) for k in range(3)], axis=1), limit)
    for block in blocks(of, strikes):
        watch.update(block)
    watch.flush()
    assert [f.channel for f in watch.findings()] == [f"{FORCE}_{axis}" for axis in "xyz"]


@pytest.mark.parametrize("step", [2.0, 0.5, 0.1])
def test_strikes_that_a_coarse_digitiser_makes_equal_are_chance(step: float) -> None:
    for seed in range(20):
        assert repeats_of(np.rint(struck(seed=seed) / step) * step) == []


def test_a_signal_that_repeats_itself_comes_to_one_value_by_nature() -> None:
    time_s = np.arange(6000) / RATE_HZ
    assert repeats_of(np.rint(8000 * np.sin(2 * np.pi * time_s)) / 100) == []
    assert repeats_of(np.tile(struck(500), 12)) == []


def test_rest_at_the_highest_value_is_no_limit() -> None:
    values = np.full(6000, 9.80665)
    for at in range(300, 5700, 400):
        values[at : at + 250] -= np.hanning(250) * np.random.default_rng(at).uniform(1, 2)
    assert repeats_of(values) == []


def test_gaps_end_the_runs_of_a_sensor() -> None:
    of = stream(GYRO, FORCE, FIELD)
    watch = ImuWatch([of])
    samples = turning_sensor(30.0)
    for block in blocks(of, samples):
        watch.update(block)
        watch.update(Gap("/imu", block.end_ns, block.end_ns + 10**9, "missing", 100))
    watch.flush()
    assert [c.windows for c in watch.checks()] == [0, 3 * 6 - 6]


def test_a_limb_that_swings_cut_short_by_the_window_is_in_order() -> None:
    time_s = np.arange(4000) / RATE_HZ
    stride = 2 * np.pi * time_s / 1.07
    angle = np.radians(40) * np.sin(stride)
    none = np.zeros_like(time_s)
    along, across = 9.81 * np.cos(angle) + 2 * np.cos(2 * stride), 9.81 * np.sin(angle)
    for sign, faults in ((-1.0, 0), (1.0, 1)):  # right-handed, and the wrong way round
        turning = sign * np.gradient(angle, time_s)
        samples = np.stack([none, turning, none, across, none, along], axis=1)
        assert len(found(samples, GYRO, FORCE)) == faults
