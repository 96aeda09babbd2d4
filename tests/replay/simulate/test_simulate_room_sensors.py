"""Sensors of the simulated room: axes, mountings, clocks, dead and clipped ones; floors, shoes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import hilbert
from scipy.special import hankel1
from simulated_rooms import L_ROOM, of_kind, one_step, samples_of, start_of, values_of

from groundtrace.errors import SimulationError
from groundtrace.localizers.wave_physics import Plate, Synthesis
from groundtrace.simulate.footfall import BARE, HEEL, ArrivalLaw, Footfall
from groundtrace.simulate.room import simulate_room
from groundtrace.simulate.room_plan import Mounting, RoomOptions


def column(simulation, channel: str) -> int:
    return [c.name for c in simulation.sources[0][0].channels].index(channel)


def onset_s(wave: np.ndarray, rate_hz: float, until_s: float) -> float:
    """Return when a wave first exceeds 5 % of its maximum before ``until_s``."""
    size = np.abs(wave[: int(until_s * rate_hz)])
    return float(np.argmax(size > 0.05 * size.max()) / rate_hz)


@pytest.mark.parametrize(
    ("options", "within_s"),
    [
        ({"thickness_m": 0.12}, 6e-4),
        ({"thickness_m": 0.3, "loss_s": 5e-5}, 6e-4),
        ({"dispersion_m2s": 100.0}, 6e-4),
        ({"shoe": "bare"}, 1e-3),
        ({"shoe": "bare", "thickness_m": 0.12}, 1.2e-3),
        ({"shoe": "mixed", "seed": 5}, 1e-3),
        ({"side_m": (12.0, 9.0), "channels": 16}, 8e-4),
        ({"geometry": L_ROOM}, 6e-4),
        ({"rate_hz": 2000.0}, 1e-3),
        ({"triaxial": True}, 1e-3),
        ({"clock_spread_s": 0.01}, 8e-4),
    ],
)
def test_waves_begin_where_the_truth_says_whatever_the_floor(options, within_s):
    simulation = one_step(**options)
    values, rate_hz = values_of(simulation), simulation.sources[0][0].rate_hz
    start_ns = start_of(simulation)
    picks = of_kind(simulation, "pick")
    assert len(picks) == values.shape[1]
    for pick in picks:
        arrival_s = (pick.time_ns - start_ns) / 1e9
        if pick.channel.endswith(("x", "y")):
            continue  # where the wave runs along the other axis there is next to nothing
        seen_s = onset_s(values[:, column(simulation, pick.channel)], rate_hz, arrival_s + 0.05)
        assert seen_s == pytest.approx(arrival_s, abs=within_s)


def test_amplitudes_decay_with_distance():
    simulation = one_step(side_m=(8.0, 8.0), channels=16)
    step = of_kind(simulation, "step")[0]
    peaks = np.abs(values_of(simulation)).max(axis=0)
    away = [np.hypot(s.x - step.x_m, s.y - step.y_m) for s in simulation.geometry.sensors]
    assert (np.diff(peaks[np.argsort(away)]) < 0.03 * peaks.max()).all()
    assert peaks[np.argmin(away)] > 3 * peaks[np.argmax(away)]


def test_a_bare_foot_is_softer_lower_and_seen_later():
    plate = Plate()
    synthesis = Synthesis.lasting(plate, 20_000.0, 0.4)
    centre_hz, peak = [], []
    for shoe in (HEEL, BARE):
        force = Footfall(shoe=shoe).spectrum(synthesis.frequency_hz) * synthesis.sensor()
        wave = synthesis.waveforms(np.array([2.0]), force)[0]
        power = np.abs(np.fft.rfft(wave)) ** 2
        frequency = np.fft.rfftfreq(synthesis.samples, 1 / 20_000)
        centre_hz.append(power @ frequency / power.sum())
        peak.append(np.abs(wave).max())
    assert centre_hz[1] < 0.7 * centre_hz[0]
    assert peak[1] < 0.5 * peak[0]
    heel, bare = (ArrivalLaw.of(plate, shoe) for shoe in (HEEL, BARE))
    assert bare.velocity_mps < heel.velocity_mps


def test_mixed_shoes_arrive_each_by_its_own_law():
    simulation = simulate_room(RoomOptions(shoe="mixed", steps=12, channels=3))
    plate = Plate()
    laws = [ArrivalLaw.of(plate, shoe) for shoe in (HEEL, BARE)]
    first = simulation.geometry.sensors[0]
    counts = [0, 0]
    for step, pick in zip(
        of_kind(simulation, "step"),
        [x for x in of_kind(simulation, "pick") if x.channel == "G1"],
        strict=True,
    ):
        away = np.hypot(step.x_m - first.x, step.y_m - first.y)
        delay_s = (pick.time_ns - step.time_ns) / 1e9
        apart = [abs(float(law(np.array(away))) - delay_s) for law in laws]
        assert min(apart) < 1e-8
        counts[int(np.argmin(apart))] += 1
    assert min(counts) >= 2


def test_the_geometry_says_the_floor():
    simulation = one_step(dispersion_m2s=100.0)
    medium = simulation.geometry.medium
    assert Plate(thickness_m=medium.thickness_m).dispersion_m2s == pytest.approx(100)
    assert medium.velocity_mps == pytest.approx(
        ArrivalLaw.of(Plate(medium.thickness_m)).velocity_mps
    )


def test_a_clock_offset_shifts_waves_and_truth_by_exactly_as_much():
    late, right = one_step(clock_offset_s=(("G2", 0.005), ("G4", -0.02))), one_step()
    a, b = samples_of(late), samples_of(right)
    np.testing.assert_array_less(np.abs(a[100:, 1].astype(int) - b[:-100, 1]), 2)
    np.testing.assert_array_less(np.abs(a[:-400, 3].astype(int) - b[400:, 3]), 2)
    np.testing.assert_array_less(np.abs(a[:, 0].astype(int) - b[:, 0]), 2)
    shifts = {
        one.channel: one.time_ns - other.time_ns
        for one in of_kind(late, "pick")
        for other in of_kind(right, "pick")
        if one.channel == other.channel
    }
    assert {k: v for k, v in shifts.items() if v} == {"G2": 5_000_000, "G4": -20_000_000}
    assert late.metadata["clock_offset_s"]["G2"] == "0.005"
    assert "clock_offset_s" not in right.metadata


def test_random_clocks_leave_named_ones_as_they_are():
    options = {"clock_spread_s": 0.004, "clock_offset_s": (("G1", 0.0),)}
    offsets = one_step(**options).metadata["clock_offset_s"]
    values = np.array([float(x) for x in offsets.values()])
    assert values[0] == 0
    assert 0.001 < values[1:].std() < 0.01


def test_an_offset_that_the_geometry_knows_is_simulated_and_told():
    known = replace(L_ROOM.sensors[0], clock_offset_s=0.004)
    site = replace(L_ROOM, sensors=(known, *L_ROOM.sensors[1:]))
    late, right = one_step(geometry=site), one_step(geometry=L_ROOM)
    assert late.geometry.sensors[0].clock_offset_s == 0.004
    times = [{x.channel: x.time_ns for x in of_kind(room, "pick")} for room in (late, right)]
    assert {k: v - times[1][k] for k, v in times[0].items()} == {
        "A": 4_000_000,
        "B": 0,
        "C": 0,
        "D": 0,
    }


def test_a_dead_sensor_is_flat_and_has_no_arrivals():
    simulation = simulate_room(RoomOptions(steps=3, dead=("G3", "G5")))
    silent = ~samples_of(simulation).any(axis=0)
    assert np.flatnonzero(silent).tolist() == [2, 4]
    assert {x.channel for x in of_kind(simulation, "pick")} == {
        f"G{i}" for i in (1, 2, 4, 6, 7, 8, 9)
    }


def test_a_clipped_sensor_saturates_at_most_steps():
    simulation = simulate_room(RoomOptions(steps=20, clipped=("G4",)))
    samples, start_ns = samples_of(simulation), start_of(simulation)
    full = (samples[:, 3] == -32768) | (samples[:, 3] == 32767)
    clipped = 0
    for step in of_kind(simulation, "step"):
        first = (step.time_ns - start_ns) * 20_000 // 10**9
        clipped += full[first : first + 2000].any()
    assert clipped > 12
    assert np.abs(np.delete(samples, 3, axis=1).astype(int)).max() < 32767
    # the gain is known: where it does not clip, it measures what the others do
    assert np.abs(values_of(simulation)[:, 3]).max() < np.abs(values_of(simulation)).max()


def test_stations_point_away_from_every_step():
    simulation = simulate_room(RoomOptions(steps=8, triaxial=True, snr=1e7))
    stations = {}
    for sensor in simulation.geometry.sensors:
        assert sensor.channel == f"{sensor.name}{sensor.axis}"
        stations.setdefault(sensor.name, []).append(sensor)
    assert len(stations) == 9
    values, start_ns = values_of(simulation), start_of(simulation)
    for step in of_kind(simulation, "step"):
        first = (step.time_ns - start_ns) * 20_000 // 10**9
        for axes in stations.values():
            x, y, z = (values[first : first + 1600, column(simulation, s.channel)] for s in axes)
            away = np.array([axes[0].x - step.x_m, axes[0].y - step.y_m])
            # ahead by a quarter of a period and away: against the vertical's Hilbert transform
            turned = -np.imag(hilbert(z))
            azimuth = np.arctan2(y @ turned, x @ turned)
            error = np.angle(np.exp(1j * (azimuth - np.arctan2(away[1], away[0]))))
            assert abs(np.degrees(error)) < 1


def test_horizontal_movement_is_retrograde_and_six_tenths_at_200_hz():
    plate, frequency = Plate(), np.array([200.0])
    lever_m = 0.6 / np.sqrt(2 * np.pi * 200 / plate.dispersion_m2s)
    for distance_m in (3.0, 8.0):
        away = np.array([distance_m])
        ratio = (plate.radial(away, frequency, lever_m) / plate.response(away, frequency))[0, 0]
        assert abs(ratio) == pytest.approx(0.6, rel=0.06)
        # where the surface is highest it moves towards the force
        assert np.degrees(np.angle(ratio)) == pytest.approx(90, abs=5)
    assert plate.radial(np.zeros(1), frequency, lever_m)[0, 0] == 0


@pytest.mark.parametrize("distance_m", [0.02, 0.5, 4.0])
def test_the_radial_movement_is_the_slope_of_the_green_function(distance_m):
    plate, frequency = Plate(loss_s=0.0), np.linspace(20.0, 2000.0, 100)
    k = np.sqrt(2 * np.pi * frequency / plate.dispersion_m2s)
    slope = -k * hankel1(1, k * distance_m) + 1j * k * hankel1(1, 1j * k * distance_m)
    radial = plate.radial(np.array([distance_m]), frequency, 0.1)[0]
    expected = -0.1 * plate.mobility_mns * slope.conj()
    assert np.abs(radial - expected).max() < 0.01 * np.abs(expected).max()


def test_every_mounting_has_its_own_peak():
    mounting = Mounting.drawn(16, seed=3)
    frequency = np.arange(1.0, 3000.0)
    response = np.abs(mounting.response(frequency))
    np.testing.assert_allclose(frequency[response.argmax(axis=1)], mounting.frequency_hz, rtol=0.05)
    np.testing.assert_allclose(response.max(axis=1), mounting.quality, rtol=0.1)
    np.testing.assert_allclose(response[:, 0], 1, atol=1e-3)
    assert len(set(mounting.frequency_hz)) == 16


def test_resonances_change_waves_and_not_the_truth():
    plain, ringing = one_step(), one_step(resonances=True)
    assert plain.labels == ringing.labels
    a, b = values_of(plain), values_of(ringing)
    assert (b.std(axis=0) > 1.2 * a.std(axis=0)).sum() >= 6
    first = min(x.time_ns for x in of_kind(plain, "pick")) - start_of(plain)
    before = int(first * 2e-5) - 20
    assert np.abs(b[:before]).max() < 0.02 * np.abs(b).max()


@pytest.mark.parametrize("rate_hz", [1000.0, 2000.0])
def test_slow_recorders_see_the_same_steps_and_arrivals(rate_hz):
    slow = simulate_room(RoomOptions(steps=5, rate_hz=rate_hz, walls=0.4, resonances=True))
    fast = simulate_room(RoomOptions(steps=5, walls=0.4, resonances=True))
    assert slow.labels == fast.labels
    assert slow.geometry == fast.geometry
    assert np.abs(samples_of(slow)).max() < 32767
    # most of a footstep lies below 500 Hz; resonances lie up to 600 Hz
    ratio = np.abs(values_of(slow)).max(axis=0) / np.abs(values_of(fast)).max(axis=0)
    assert (ratio > (0.3 if rate_hz < 2000 else 0.8)).all()


@pytest.mark.parametrize(
    "options",
    [
        RoomOptions(dead=("G77",)),
        RoomOptions(clipped=("",)),
        RoomOptions(clock_offset_s=(("G0", 0.01),)),
        RoomOptions(clock_offset_s=(("G1", 0.2),)),
        RoomOptions(clock_spread_s=-0.001),
        RoomOptions(side_m=(1.0, 5.0)),
        RoomOptions(thickness_m=0.01),
        RoomOptions(dispersion_m2s=10.0),
        RoomOptions(thickness_m=0.2, dispersion_m2s=183.0),
        RoomOptions(loss_s=0.0),
        RoomOptions(walls=0.95),
        RoomOptions(walls=float("nan")),
        RoomOptions(walkers=3),
        RoomOptions(walkers=2, path="u"),
        RoomOptions(walkers=1, path="crossing"),
        RoomOptions(impacts=True, path="u"),
        RoomOptions(impacts=True, walkers=2),
        RoomOptions(geometry=L_ROOM, side_m=(5.0, 5.0)),
        RoomOptions(geometry=L_ROOM, channels=5),
        RoomOptions(impacts=True, steps=10, duration_s=5.0),
    ],
)
def test_impossible_sensors_and_floors_are_refused(options):
    with pytest.raises(SimulationError, match=r"^simulate room: .*expected .*, found"):
        simulate_room(options)
