"""The room: waves, steps and truth agree with each other."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from scipy.special import hankel1
from simulated_rooms import of_kind, samples_of

from groundtrace.errors import SimulationError
from groundtrace.localizers.wave_physics import Plate, Synthesis
from groundtrace.simulate.footfall import ArrivalLaw, Footfall
from groundtrace.simulate.room import simulate_room
from groundtrace.simulate.room_plan import SIDE_M, RoomOptions, sensor_places

if TYPE_CHECKING:
    from groundtrace.simulate.recording import Simulation

SHORT = RoomOptions(duration_s=4.0, channels=9)


def distances(simulation: Simulation, step) -> dict[str, float]:
    return {
        s.channel: float(np.hypot(s.x - step.x_m, s.y - step.y_m))
        for s in simulation.geometry.sensors
    }


def onset_s(law_plate: Plate, distance_m: np.ndarray) -> np.ndarray:
    synthesis = Synthesis.lasting(law_plate, 20_000.0, 0.08)
    force = Footfall(toe=0.0).spectrum(synthesis.frequency_hz) * synthesis.sensor()
    velocity = np.abs(synthesis.waveforms(distance_m, force))
    return np.argmax(velocity > 0.05 * velocity.max(axis=1, keepdims=True), axis=1) / 20_000.0


@pytest.fixture(scope="module")
def room() -> Simulation:
    return simulate_room()


def test_the_plate_is_the_thesis_concrete():
    plate = Plate()
    assert plate.dispersion_m2s == pytest.approx(183, abs=1)
    assert plate.mobility_mns == pytest.approx(1 / (8 * np.sqrt(plate.rigidity_nm * 500)))


@pytest.mark.parametrize("distance_m", [0.1, 1.0, 5.0, 10.0])
def test_the_response_is_the_green_function_with_a_complex_wavenumber(distance_m):
    plate, frequency = Plate(), np.linspace(5, 2500, 400)
    omega = 2 * np.pi * frequency
    k = np.sqrt(omega / plate.dispersion_m2s) * (1 + 0.25j * plate.loss_s * omega)
    velocity = plate.mobility_mns * (hankel1(0, k * distance_m) - hankel1(0, 1j * k * distance_m))
    response = plate.response(np.array([distance_m]), frequency)[0]
    assert np.abs(response - velocity.conj()).max() < 0.02 * np.abs(velocity).max()


def test_the_response_at_the_force_is_the_mobility():
    plate = Plate()
    response = plate.response(np.zeros(1), np.array([10.0, 1000.0]))
    np.testing.assert_allclose(response, plate.mobility_mns)


def test_high_frequencies_arrive_first():
    synthesis = Synthesis.lasting(Plate(), 20_000.0, 0.2)
    frequency = synthesis.frequency_hz
    centre_s = []
    for middle_hz in (100.0, 400.0, 1600.0):
        band = np.exp(-(((frequency - middle_hz) / (0.2 * middle_hz)) ** 2))
        wave = synthesis.waveforms(np.array([8.0]), band * np.exp(-0.1j * np.pi * frequency))[0]
        centre_s.append(wave**2 @ np.arange(wave.size) / (wave @ wave) / 20_000 - 0.05)
    group = 2 * np.sqrt(Plate().dispersion_m2s * 2 * np.pi * np.array([100.0, 400.0, 1600.0]))
    np.testing.assert_allclose(8.0 / np.array(centre_s), group, rtol=0.06)


def test_peaks_decay_with_distance():
    synthesis = Synthesis.lasting(Plate(), 20_000.0, 0.2)
    force = Footfall().spectrum(synthesis.frequency_hz) * synthesis.sensor()
    waves = synthesis.waveforms(np.array([0.2, 0.5, 1.0, 2.0, 4.0, 8.0]), force)
    peaks = np.abs(waves).max(axis=1)
    assert (np.diff(peaks) < 0).all()
    assert peaks[2] / peaks[5] > 3


def test_most_of_a_footstep_lies_between_50_and_400_hz():
    synthesis = Synthesis.lasting(Plate(), 20_000.0, 0.4)
    force = Footfall().spectrum(synthesis.frequency_hz) * synthesis.sensor()
    power = np.abs(np.fft.rfft(synthesis.waveforms(np.array([3.0]), force)[0])) ** 2
    frequency = np.fft.rfftfreq(synthesis.samples, 1 / 20_000)
    assert power[(frequency > 50) & (frequency < 400)].sum() > 0.85 * power.sum()


def test_the_arrival_law_follows_the_waves():
    law, distance = ArrivalLaw.of(Plate()), np.arange(0.4, 7.5, 0.1)
    error = law(distance) - onset_s(Plate(), distance)
    assert np.sqrt(np.mean(error**2)) < 2e-4
    assert np.abs(error).max() < 5e-4


def test_travel_time_grows_with_a_power_between_one_and_four_thirds():
    law = ArrivalLaw.of(Plate())
    assert 1.0 <= law.exponent <= 4 / 3
    travel = law(np.array([1.0, 2.0, 4.0])) - law.offset_s
    np.testing.assert_allclose(travel[1:] / travel[:-1], 2**law.exponent)


def test_picks_come_in_the_order_of_distance(room):
    picks = of_kind(room, "pick")
    steps = of_kind(room, "step")
    for step, following in zip(steps, [*steps[1:], None], strict=True):
        until = following.time_ns if following else step.time_ns + 10**9
        mine = [p for p in picks if step.time_ns < p.time_ns < until]
        away = distances(room, step)
        order = [p.channel for p in mine]
        assert len(mine) == 9
        assert [away[c] for c in order] == sorted(away.values())


def test_the_default_room_is_twenty_steps_in_thirteen_seconds(room):
    assert len(of_kind(room, "step")) == 20
    assert samples_of(room).shape == (260_000, 9)
    assert [s.label for s in of_kind(room, "step")[:3]] == ["left", "right", "left"]
    gaps = np.diff([s.time_ns for s in of_kind(room, "step")]) / 1e9
    assert gaps.min() >= 0.5
    assert gaps.max() <= 0.6
    assert gaps.std() > 0.01


def test_every_sensor_sees_every_default_step(room):
    samples = samples_of(room)
    start_ns = next(iter(room.sources[0][2])).anchor_ns
    quiet = samples[:14_000].std(axis=0)
    for step in of_kind(room, "step"):
        first = int((step.time_ns - start_ns) * 20_000 // 10**9)
        assert (np.abs(samples[first : first + 1200]).max(axis=0) > 15 * quiet).all()


def test_nothing_moves_before_a_step_is_picked():
    options = RoomOptions(duration_s=2.0, steps=1, snr=1e5)
    simulation = simulate_room(options)
    values = np.concatenate([block.values for block in simulation.sources[0][2]])
    start_ns = next(iter(simulation.sources[0][2])).anchor_ns
    step_at = (of_kind(simulation, "step")[0].time_ns - start_ns) * 20_000 // 10**9
    assert np.abs(values[: step_at - 20]).max() < 1e-3 * np.abs(values).max()
    for pick in of_kind(simulation, "pick"):
        column = [c.name for c in simulation.sources[0][0].channels].index(pick.channel)
        velocity = np.abs(values[:, column])
        seen_s = np.argmax(velocity > 0.05 * velocity[: step_at + 1600].max()) / 20_000
        assert seen_s == pytest.approx((pick.time_ns - start_ns) / 1e9, abs=8e-4)


def test_the_noise_has_the_level_asked_for():
    values = []
    for snr in (20.0, 200.0):
        simulation = simulate_room(RoomOptions(duration_s=2.0, steps=1, snr=snr))
        values.append(next(iter(simulation.sources[0][2])).values[:15_000].std(axis=0))
    np.testing.assert_allclose(values[0] / values[1], 10, rtol=0.05)
    assert len(set(np.round(values[0], 9))) == 9


def test_the_digitiser_never_clips():
    for snr in (1.0, 1e6):
        simulation = simulate_room(RoomOptions(duration_s=30.0, channels=16, snr=snr))
        assert np.abs(samples_of(simulation)).max() < 32767


def test_same_seed_same_samples_and_another_seed_others():
    first, again = simulate_room(SHORT), simulate_room(SHORT)
    other = simulate_room(RoomOptions(seed=7, duration_s=4.0))
    assert samples_of(first).tobytes() == samples_of(again).tobytes()
    assert samples_of(first).tobytes() == samples_of(first).tobytes()
    assert first.labels == again.labels
    assert samples_of(first).tobytes() != samples_of(other).tobytes()
    assert first.labels != other.labels


@pytest.mark.parametrize("channels", range(3, 17))
def test_any_number_of_sensors_spreads_over_the_room(channels):
    places = sensor_places(channels)
    assert len({tuple(p) for p in places.tolist()}) == channels
    assert places.min() == 0
    assert places.max() == SIDE_M
    assert np.linalg.matrix_rank(places - places.mean(axis=0)) == 2


@pytest.mark.parametrize(("duration_s", "rate_hz"), [(1.7, 20_000.0), (2.25, 1000.0), (3, 4410.5)])
def test_sample_counts_follow_duration_and_rate(duration_s, rate_hz):
    simulation = simulate_room(RoomOptions(duration_s=duration_s, rate_hz=rate_hz, channels=3))
    assert samples_of(simulation).shape == (round(duration_s * rate_hz), 3)
    blocks = list(simulation.sources[0][2])
    assert [b.first for b in blocks[1:]] == np.cumsum([len(b) for b in blocks[:-1]]).tolist()


def test_truth_lies_inside_recording_and_room():
    simulation = simulate_room(RoomOptions(duration_s=30.0, channels=4, rate_hz=2000.0))
    blocks = list(simulation.sources[0][2])
    times = [label.time_ns for label in simulation.labels]
    assert times == sorted(times)
    assert blocks[0].start_ns <= times[0]
    assert max(times) < blocks[-1].end_ns
    walking = of_kind(simulation, "walking")[0]
    for step in of_kind(simulation, "step"):
        assert walking.time_ns < step.time_ns < walking.end_ns
        assert 0 < step.x_m < SIDE_M
        assert 0 < step.y_m < SIDE_M
    assert len(of_kind(simulation, "step")) == pytest.approx(28.6 / 0.55, abs=2)


def test_a_long_walk_goes_back_and_forth_in_paces():
    steps = of_kind(simulate_room(RoomOptions(duration_s=90.0, rate_hz=1000.0)), "step")
    places = np.array([(s.x_m, s.y_m) for s in steps])
    paces = np.hypot(*np.diff(places, axis=0).T)
    assert np.median(paces) == pytest.approx(0.6, abs=0.05)
    assert paces.max() < 0.8


@pytest.mark.parametrize(
    "options",
    [
        RoomOptions(channels=2),
        RoomOptions(channels=17),
        RoomOptions(rate_hz=10.0),
        RoomOptions(snr=0.0),
        RoomOptions(steps=0),
        RoomOptions(duration_s=-1.0),
        RoomOptions(duration_s=0.5),
        RoomOptions(duration_s=3.0, steps=20),
    ],
)
def test_impossible_rooms_are_refused(options):
    with pytest.raises(SimulationError, match=r"expected .*, found"):
        simulate_room(options)
