"""Rooms of other wave laws: speeds, dispersion, layers, gains, rails, and what is no step."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simulated_rooms import of_kind, samples_of

from groundtrace.errors import SimulationError
from groundtrace.simulate.room import simulate_room
from groundtrace.simulate.room_plan import RoomOptions, any_law
from groundtrace.simulate.wave_laws import EXPONENTS, UNEVEN_M, Ground, UnevenFloor, ground_of


def phase_mps(ground: Ground, frequency_hz: float) -> float:
    """Return the velocity between 5.0 and 5.1 m, by the turn of the phase."""
    near, far = ground.response(np.array([5.0, 5.1]), np.array([frequency_hz]))[:, 0]
    return float(0.1 * 2 * np.pi * frequency_hz / -np.angle(far / near))


@pytest.mark.parametrize("law", ["f0.5", "f0.3", "f0", "f-0.3"])
def test_the_phase_velocity_is_a_power_of_frequency(law: str) -> None:
    ground = ground_of(law, 3, speed_mps=400.0)
    assert phase_mps(ground, 100.0) == pytest.approx(400.0, rel=1e-6)
    ratio = phase_mps(ground, 300.0) / phase_mps(ground, 75.0)
    assert ratio == pytest.approx(4.0 ** EXPONENTS[law], rel=1e-6)


def test_the_head_wave_of_a_layer_comes_first_beyond_a_distance() -> None:
    layered = Ground(300.0, 0.0, below_mps=1200.0, depth_m=0.5)
    far_m, delay_s = 9.0, 2 * 0.5 * np.sqrt(300.0**-2 - 1200.0**-2)
    frequency = np.arange(0.0, 2000.0, 2.0)
    head = layered.response(np.array([far_m]), frequency) - Ground(300.0, 0.0).response(
        np.array([far_m]), frequency
    )
    pulse = np.fft.irfft(head[0], 2000)  # 4 samples a millisecond
    expected_s = far_m / 1200.0 + delay_s
    assert int(np.abs(pulse).argmax()) / 4000 == pytest.approx(expected_s, abs=1e-3)
    assert expected_s < far_m / 300.0


def test_waves_lose_height_with_distance_and_high_frequencies_more() -> None:
    size = np.abs(ground_of("f0", 1).response(np.array([1.0, 4.0, 8.0]), np.array([50.0, 800.0])))
    assert (np.diff(size, axis=0) < 0).all()
    assert size[2, 1] / size[0, 1] < size[2, 0] / size[0, 0]


def test_sensors_differ_by_their_gains_alone() -> None:
    plain, spread = (
        simulate_room(RoomOptions(steps=2, wave_law="f0", snr=1e6, gain_spread=spread))
        for spread in (None, 0.3)
    )
    one, other = (np.abs(samples_of(x)).max(axis=0) for x in (plain, spread))
    ratio = other / one
    assert np.ptp(np.log(ratio)) > 0.3
    assert plain.labels == spread.labels


def test_amplifiers_clip_at_their_full_scale_on_both_sides() -> None:
    simulation = simulate_room(RoomOptions(steps=3, wave_law="f0", clip_at=0.2))
    counts = samples_of(simulation)
    rail = counts.max()
    assert (counts.min(), (counts == rail).sum() > 10) == (-rail - 1, True)


def test_an_uneven_floor_s_slowness_differs_by_its_part_and_is_mirrored_beyond_its_walls() -> None:
    low, high = np.array([-1.0, 2.0]), np.array([9.0, 8.0])
    floor = UnevenFloor.drawn(low, high, 0.15, UNEVEN_M, np.random.default_rng(1))
    assert np.log(floor.slowness).std() == pytest.approx(0.15)
    beside = np.corrcoef(floor.slowness[:-1].ravel(), floor.slowness[1:].ravel())[0, 1]
    assert beside > 0.95  # smooth over a lattice of a quarter of a metre
    source, places = np.array([0.0, 3.0]), np.array([[8.0, 7.0], [0.0, 3.0], [4.0, 3.0]])
    lengths_m = floor.lengths_m(source, places)
    assert lengths_m[1] == 0
    ratio = lengths_m[[0, 2]] / [np.hypot(8, 4), 4.0]
    assert (ratio != 1).all()
    assert (ratio < floor.most).all()
    mirrored = places * [-1, 1] + [2 * low[0], 0]
    np.testing.assert_allclose(
        floor.lengths_m(source * [-1, 1] + [2 * low[0], 0], mirrored), lengths_m, rtol=1e-9
    )
    even = UnevenFloor.drawn(low, high, 0.0, UNEVEN_M, np.random.default_rng(1))
    np.testing.assert_array_equal(even.lengths_m(source, places), np.hypot(*(places - source).T))


def test_waves_and_their_arrivals_come_as_late_as_an_uneven_floor_makes_them() -> None:
    given = RoomOptions(impacts=True, steps=1, wave_law="f0", snr=1e6, channels=4, seed=3)
    arrived_s, risen_s = [], []
    for part in (None, 0.3):
        room = simulate_room(replace(given, uneven=part))
        at_ns = {x.channel: x.time_ns for x in of_kind(room, "pick")}
        arrived_s.append([at_ns[channel.name] / 1e9 for channel in room.sources[0][0].channels])
        size = np.abs(samples_of(room))
        risen_s.append(np.argmax(size > 0.2 * size.max(axis=0), axis=0) / given.rate_hz)
    late_s = np.subtract(*arrived_s[::-1])
    assert np.ptp(late_s) > 5e-4
    np.testing.assert_allclose(np.subtract(*risen_s[::-1]), late_s, atol=3e-4)


def test_precursors_and_bursts_are_signal_but_no_truth() -> None:
    quiet, loud = (
        simulate_room(RoomOptions(steps=4, wave_law="f-0.3", seed=8, duration_s=12.0, **more))
        for more in ({}, {"precursor_s": 0.1, "bursts": 20.0})
    )
    assert quiet.labels == loud.labels
    assert len(of_kind(loud, "step")) >= 4
    assert np.any(samples_of(quiet) != samples_of(loud))


def test_any_law_is_drawn_from_the_seed_and_keeps_what_is_given() -> None:
    drawn = [any_law(RoomOptions(seed=seed, wave_law="any")) for seed in range(60)]
    assert {x.wave_law for x in drawn} == {"plate", *EXPONENTS}
    assert drawn[7] == any_law(RoomOptions(seed=7, wave_law="any"))
    assert any_law(RoomOptions(seed=7, wave_law="any", clip_at=9.0)).clip_at == 9.0


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"speed_mps": 300.0}, "speed_mps: expected none beside the law of a plate"),
        ({"wave_law": "f0", "speed_mps": 20.0}, "80 to 3000"),
        ({"gain_spread": 2.0}, "0 to 1"),
        ({"precursor_s": 0.2}, "0 to 0.1"),
        ({"bursts": -1.0}, "0 to 60"),
        ({"uneven": 0.7}, "0 to 0.5"),
    ],
)
def test_options_out_of_range_are_one_clear_line(options: dict, expected: str) -> None:
    with pytest.raises(SimulationError, match=expected):
        simulate_room(RoomOptions(**options))
