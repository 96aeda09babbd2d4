"""What a sensor on a thin plate sees: waveform, envelope, velocities and onsets."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import hilbert

from groundtrace.localizers.wave_physics import (
    Plate,
    Response,
    Synthesis,
    arrivals,
    envelope,
    front_arrival_s,
    front_mps,
    onset_s,
    sensor_arrival_s,
    sensor_mps,
    wavenumber,
)

#: The thesis's concrete with its a rounded as printed: 183 m2/s.
ROUNDED = replace(Plate(), young_pa=24e9 * (183 / Plate().dispersion_m2s) ** 2)
DISTANCES = np.array([2.0, 5.0, 10.0, 15.0, 20.0])


def test_the_sum_is_equation_4_9_term_by_term():
    response = Response(Plate(), terms=256)
    time = response.time_s(20_000.0)
    omega = response.omega
    k = np.sqrt(omega / Plate().dispersion_m2s)
    terms = np.exp(-k * 1e-5 * omega / 4 * 8.0) * np.cos(k * 8.0 - np.outer(time, omega))
    expected = terms.sum(axis=1) * 2 * np.pi * 10_000 / 256 / np.sqrt(2 * np.pi)
    np.testing.assert_allclose(
        response.analytic(np.array([8.0]), 20_000.0)[0].real, expected, atol=1e-9
    )


def test_the_wavenumber_for_small_loss_is_that_of_4_5():
    omega = 2 * np.pi * np.array([100.0, 1000.0])
    small = np.sqrt(omega / Plate().dispersion_m2s) * (1 + 0.25j * 1e-5 * omega)
    np.testing.assert_allclose(wavenumber(Plate(), omega), small, rtol=1e-3)
    exact = wavenumber(Plate(), omega)
    left = Plate().dispersion_m2s ** 2 * (1 - 1j * 1e-5 * omega) * exact**4
    np.testing.assert_allclose(left, omega**2)  # (4.3)


@pytest.mark.parametrize("distance_m", [5.0, 10.0, 20.0])
def test_far_from_a_force_the_green_function_of_the_plate_gives_the_same_wave(distance_m):
    """Independent of (4.9): Hankel functions, another grid of frequencies, another transform."""
    plate = Plate()

    def band(frequency_hz: np.ndarray) -> np.ndarray:
        late = np.exp(-2j * np.pi * frequency_hz * 0.02)
        return np.exp(-(((frequency_hz - 500) / 150) ** 2)) * late

    synthesis = Synthesis.lasting(plate, 20_000.0, 0.3)
    k = np.sqrt(2 * np.pi * synthesis.frequency_hz[1:] / plate.dispersion_m2s)
    spread = plate.mobility_mns * np.sqrt(2 / (np.pi * k * distance_m)) * np.exp(0.25j * np.pi)
    force = np.concatenate(([0], band(synthesis.frequency_hz[1:]) / spread))
    point = synthesis.waveforms(np.array([distance_m]), force)[0] * np.sqrt(np.pi / 2)

    response = Response(plate)
    source = band(response.omega / (2 * np.pi)).conj()  # exp(-i w t), the other sign
    plane = response.analytic(np.array([distance_m]), 200_000.0, source)[0].real
    time = np.arange(point.size) / 20_000
    ours = np.interp(time, response.time_s(200_000.0), plane)
    until = time < 0.15
    error = np.abs(ours - point)[until].max() / np.abs(point).max()
    k_500 = np.sqrt(2 * np.pi * 500 / plate.dispersion_m2s)
    # the next term of the Hankel function, which the plane wave lacks
    assert error == pytest.approx(1 / (8 * k_500 * distance_m), rel=0.1)


def test_the_envelope_of_the_waveform_tends_to_stationary_phase_with_distance():
    response = Response(Plate(), terms=65_536)
    time = response.time_s(40_000.0)
    error = []
    for distance in (5.0, 10.0, 20.0, 40.0):
        found = np.abs(hilbert(response.analytic(np.array([distance]), 40_000.0)[0].real))
        peak_s = sensor_arrival_s(Plate(), distance)
        about = (time > 0.3 * peak_s) & (time < 3 * peak_s)
        limit = envelope(Plate(), distance, time[about])
        error.append(np.abs(found[about] - limit).max() / limit.max())
    assert (np.diff(error) < 0).all()
    assert error[0] < 0.035
    assert error[2] < 0.006  # at 20 m


def test_the_sensor_sees_the_maximum_faster_than_the_front_by_the_cube_root_of_two():
    """Both maxima found on the envelope itself, not from their formulas."""
    for distance in DISTANCES:
        time = sensor_arrival_s(Plate(), distance) * np.linspace(0.5, 2, 60_001)
        at_sensor = time[np.argmax(envelope(Plate(), distance, time))]
        instant = front_arrival_s(Plate(), distance)
        places = distance * np.linspace(0.5, 2, 60_001)
        front = places[np.argmax(envelope(Plate(), places, instant))]
        assert front == pytest.approx(distance, rel=1e-4)
        ratio = distance / at_sensor / (front / instant)
        assert 1.2598 <= ratio <= 1.2600


def test_velocities_and_arrivals_are_the_printed_law_and_the_corrected_one():
    d, a, theta = DISTANCES, Plate().dispersion_m2s, 1e-5
    np.testing.assert_allclose(front_mps(Plate(), d), np.cbrt(8 * a**2 / (theta * d)))
    np.testing.assert_allclose(sensor_mps(Plate(), d), np.cbrt(16 * a**2 / (theta * d)))
    np.testing.assert_allclose(front_arrival_s(Plate(), d), d / front_mps(Plate(), d))
    np.testing.assert_allclose(sensor_arrival_s(Plate(), d), d / sensor_mps(Plate(), d))
    np.testing.assert_allclose(front_arrival_s(ROUNDED, d), arrivals(d, theta))


def test_the_waveform_peaks_when_the_corrected_law_says_not_the_printed_one():
    response = Response(Plate(), terms=65_536)
    signal = response.analytic(DISTANCES[1:], 40_000.0)
    peak_s = response.time_s(40_000.0)[np.argmax(np.abs(signal), axis=1)]
    np.testing.assert_allclose(peak_s / sensor_arrival_s(Plate(), DISTANCES[1:]), 1, atol=0.03)
    np.testing.assert_allclose(front_arrival_s(Plate(), DISTANCES[1:]) / peak_s, 1.26, atol=0.04)


def test_the_onset_over_200_has_the_velocities_of_the_figures():
    distance = DISTANCES[1:]
    velocity = distance / onset_s(Response(ROUNDED), distance)
    assert ROUNDED.dispersion_m2s == pytest.approx(183)
    assert np.round(velocity).tolist() == [3968, 2874, 2500, 2110]


def test_the_maxima_come_in_the_order_of_distances():
    distance = np.arange(0.1, 30.0, 0.05)
    assert (np.diff(front_arrival_s(Plate(), distance)) > 0).all()
    assert (np.diff(sensor_arrival_s(Plate(), distance)) > 0).all()


def test_onsets_come_in_the_order_of_distances_that_differ_by_half_a_metre():
    """(4.13) is not strict: at some distances the first swing over the level changes."""
    distance = np.arange(3.0, 20.0, 0.05)
    onset = onset_s(Response(Plate(), terms=16_384), distance)
    assert -4.4e-4 < np.diff(onset).min() < -3e-4
    apart = distance[:, None] - distance > 0.475  # 0.5 m and more
    assert (onset[:, None] > onset)[apart].all()


def test_a_level_that_is_never_reached_has_no_onset():
    assert np.isnan(onset_s(Response(Plate()), np.array([10.0]), level=1e6)).all()
