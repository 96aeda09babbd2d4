"""``simulate_vehicle``: the power law, delays, Doppler, fading, and the other things one hears."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from scipy.signal import hilbert, welch
from simulated_roads import QUIET, of_kind, simulated, values_of

from groundtrace.simulate.road import VehicleOptions
from groundtrace.simulate.vehicle_signal import LEVEL_MPS, RADIAL, Source, between, margin, sampled
from groundtrace.vehicles.medium import Geophone, PowerLaw, loss_per_m
from groundtrace_codecs.geometry import Geometry, Sensor

RATE = 200.0


def sensors_at(*places: tuple[float, float]) -> Geometry:
    return Geometry(
        sensors=tuple(Sensor(f"G{i}", f"G{i}", x, y) for i, (x, y) in enumerate(places))
    )


def source(**changed: object) -> Source:
    chosen = {"parts": 1, "engine_hz": None, "engine_share": 0.3, "seed": (3, 1)} | changed
    return Source(RATE, (10.0, 40.0), **chosen)


def noise_of(one: Source, seconds: int) -> np.ndarray:
    return one.frames().samples(0, round(seconds * RATE))


def test_a_source_has_unit_power_in_its_band_that_moves():
    values = noise_of(source(), 600)[:, 0]
    assert np.mean(values.real**2) == pytest.approx(1, rel=0.05)
    assert np.mean(values.imag**2) == pytest.approx(1, rel=0.05)
    frequency, density = welch(values.real, RATE, nperseg=400)
    inside = (frequency > 10 * 0.8) & (frequency < 40 * 1.25)
    assert density[~inside].sum() < 0.01 * density.sum()
    means = []
    for part in values.real.reshape(-1, 800):
        spectrum = np.abs(np.fft.rfft(part)) ** 2
        means.append(np.average(np.fft.rfftfreq(800, 1 / RATE), weights=spectrum))
    # Of 4 s of a band that stood still the mean frequency has a spread of 30 / sqrt(12 * 120) Hz.
    assert np.std(means) > 1.3 * 30 / np.sqrt(12 * 120)


def test_noise_is_gaussian():
    values = noise_of(source(), 600)[:, 0].real
    assert np.mean(values**4) / np.mean(values**2) ** 2 == pytest.approx(3, abs=0.15)


def test_parts_of_the_band_add_up_to_the_whole_and_tones_take_their_share():
    whole = noise_of(source(parts=8), 300)
    assert np.mean(whole.sum(axis=1).real ** 2) == pytest.approx(1, rel=0.05)
    engine = source(engine_hz=12.0)
    tones = engine.tones(np.arange(60_000) / RATE)
    assert np.mean(tones.sum(axis=1).real ** 2) == pytest.approx(0.3, rel=0.01)
    assert np.mean(noise_of(engine, 600).real ** 2) == pytest.approx(0.7, rel=0.05)
    assert engine.frequencies_hz()[1:] == pytest.approx([12, 24, 36, 48])


def test_any_piece_of_noise_is_the_same_whatever_was_asked_before():
    one, other = source().frames(), source().frames()
    one.samples(5000, 300)
    assert np.array_equal(one.samples(-300, 900)[450:600], other.samples(150, 150))


def test_values_between_samples_are_those_of_the_signal():
    time = np.arange(400) / RATE
    for hz in (5.0, 40.0, 78.0):
        wave = np.exp(2j * np.pi * hz * time)[:, None]
        at = np.linspace(margin(), 399 - margin(), 777)
        error = between(wave, at)[:, 0] - np.exp(2j * np.pi * hz * at / RATE)
        assert np.abs(error).max() < 1e-3


@pytest.mark.parametrize(("exponent", "loss_spm"), [(1.5, 0.0), (2.5, 0.0), (1.0, 2e-4)])
def test_power_falls_with_distance_as_the_law_has_it(exponent, loss_spm):
    """One vehicle drives by sensors at six distances; its noise is the same for all."""
    distance = np.array([2.0, 5.0, 10.0, 20.0, 40.0, 80.0])
    site = sensors_at(*((0.0, -float(y)) for y in distance))
    loud = simulated(
        geometry=site,
        offset_m=float(distance.mean()),
        speed_mps=2.0,
        duration_s=100.0,
        exponent=exponent,
        loss_spm=loss_spm,
        velocity_mps=3000.0,
        snr=QUIET,
    )
    values = values_of(loud)
    time_s = np.arange(len(values)) / RATE
    along = 2.0 * (time_s - 50.0)
    r = np.hypot(along[:, None], distance)
    expected = expected_power(r, exponent, loss_spm)
    measured = np.mean(values**2 / expected, axis=0)
    assert measured == pytest.approx(np.ones(6), rel=0.06)
    slope = np.polyfit(np.log(distance), np.log(measured), 1)[0]
    assert abs(slope) < 0.01


def expected_power(r: np.ndarray, exponent: float, loss_spm: float) -> np.ndarray:
    """Average the law over the band as (2) integrates it, the band's wander among it."""
    frequency = np.linspace(8.0, 48.0, 401)
    scale = np.linspace(0.85, 1.15, 31)[:, None]
    flat = ((frequency / scale > 10) & (frequency / scale < 40)).mean(axis=0)
    weights = flat / flat.sum()
    total = np.zeros(r.shape)
    for hz, weight in zip(frequency[::10], weights.reshape(-1, 1)[::10, 0], strict=True):
        total += weight * PowerLaw(LEVEL_MPS**2, exponent, loss_per_m(loss_spm, hz)).power(r)
    return total / weights[::10].sum()


def test_waves_need_their_way_over_the_velocity():
    """Two sensors ahead in line: the farther one hears the same, 40 m over 200 m/s later."""
    site = sensors_at((200.0, 0.0), (240.0, 0.0))
    loud = simulated(
        geometry=site, offset_m=0.0, speed_mps=10.0, velocity_mps=200.0, duration_s=20.0, snr=QUIET
    )
    near, far = values_of(loud)[:800].T
    lags = np.arange(-80, 81)
    product = [np.dot(near[200:600], far[200 + lag : 600 + lag]) for lag in lags]
    assert lags[int(np.argmax(product))] == 40


@pytest.mark.parametrize("at_s", [5.0, 25.0])
def test_tones_rise_before_the_pass_and_fall_after_it(at_s):
    """Doppler: f c / (c - v) as it comes, f c / (c + v) as it goes."""
    speed, velocity = 30.0, 250.0
    site = sensors_at((0.0, 0.0))
    loud = simulated(
        geometry=site,
        offset_m=2.0,
        speed_mps=speed,
        velocity_mps=velocity,
        duration_s=30.0,
        engine_hz=20.0,
        band_hz=(45.0, 55.0),
        snr=QUIET,
    )
    first = round((at_s - 4) * RATE)
    part = values_of(loud)[first : first + 1600, 0] * np.hanning(1600)
    spectrum = np.abs(np.fft.rfft(part, 1 << 16))
    frequency = np.fft.rfftfreq(1 << 16, 1 / RATE)
    tone = (frequency > 16) & (frequency < 25)
    found = frequency[tone][np.argmax(spectrum[tone])]
    towards = 1 if at_s < 15 else -1
    # The engine's own rate swings by 2 %.
    assert found == pytest.approx(20 / (1 - towards * speed / velocity), rel=0.021)


def test_fading_gives_ratios_of_powers_the_law_of_the_paper():
    """(10): for sensors as far as each other half the ratios are below 1, 1 in 11 below 0.1."""
    site = sensors_at((0.0, 60.0), (0.0, -60.0))
    loud = simulated(
        geometry=site,
        offset_m=0.0,
        speed_mps=30.0,
        duration_s=120.0,
        coherence_m=1.0,
        velocity_mps=3000.0,
        snr=QUIET,
    )
    power = np.abs(hilbert(values_of(loud), axis=0)) ** 2
    ratio = (power[:, 0] / power[:, 1])[::20]
    for limit in (0.1, 1.0, 10.0):
        assert np.mean(ratio < limit) == pytest.approx(limit / (1 + limit), abs=0.03)
    coherent = simulated(geometry=site, offset_m=0.0, duration_s=20.0, snr=QUIET)
    values = values_of(coherent)
    assert np.corrcoef(values.T)[0, 1] > 0.999


def test_horizontal_motion_is_retrograde_and_along_the_way_of_the_waves():
    site = sensors_at((0.0, 0.0))
    loud = simulated(
        geometry=site, components=3, offset_m=0.0, heading_deg=60.0, duration_s=20.0, snr=QUIET
    )
    values = values_of(loud)[:1200]  # comes from -120 degrees, so that away is +60 degrees
    x, y, z = hilbert(values, axis=0).T
    away = x * np.cos(np.pi / 3) + y * np.sin(np.pi / 3)
    assert np.vdot(z, away) / np.vdot(z, z) == pytest.approx(1j * RADIAL, abs=0.02)
    across = y * np.cos(np.pi / 3) - x * np.sin(np.pi / 3)
    assert np.std(across) < 0.01 * np.std(away)


def test_noise_has_the_level_that_snr_says():
    quiet = simulated(duration_s=10.0, snr=0.1, layout="stations", offset_m=1000.0)
    expected = LEVEL_MPS * 10**-0.75 / 0.1
    assert np.std(values_of(quiet)) == pytest.approx(expected, rel=0.15)


def test_wind_lies_below_8_hz_and_has_its_level():
    calm, windy = (
        simulated(duration_s=60.0, snr=0.01, offset_m=1000.0, wind=wind, layout="stations")
        for wind in (0.0, 3.0)
    )
    wind = values_of(windy) - values_of(calm)
    sigma = LEVEL_MPS * 10**-0.75 / 0.01
    assert np.sqrt(np.mean(wind**2)) / sigma == pytest.approx(3.0, rel=0.25)
    frequency, density = welch(wind[:, 0], RATE, nperseg=400)
    assert density[frequency > 10].sum() < 0.01 * density.sum()


def test_gains_are_told_and_scale_a_channel():
    plain, gained = (simulated(gain_spread=g, duration_s=5.0) for g in (0.0, 0.3))
    told = gained.metadata["sensor_gain"]
    for column, channel in enumerate(gained.sources[0][0].channels):
        ratio = np.std(values_of(gained)[:, column]) / np.std(values_of(plain)[:, column])
        assert ratio == pytest.approx(float(told[channel.name]), rel=0.02)


def test_the_filter_of_samples_is_the_geophone():
    from scipy.signal import freqz

    frequency = np.array([2.0, 4.5, 10.0, 20.0])
    geophone = Geophone(4.5)
    _, found = freqz(*sampled(geophone, RATE), worN=frequency, fs=RATE)
    assert np.abs(found - geophone.response(frequency)).max() < 0.03


def test_a_geophone_takes_low_frequencies_off():
    plain, sensed = (
        simulated(geophone_hz=hz, duration_s=20.0, snr=QUIET, band_hz=(10.0, 40.0))
        for hz in (None, 30.0)
    )
    ratio = np.std(values_of(sensed), axis=0) / np.std(values_of(plain), axis=0)
    assert np.all((ratio > 0.2) & (ratio < 0.8))


def test_the_same_seed_gives_the_same_samples_and_another_seed_others():
    options = {"passes": 2, "overlap": True, "walkers": 1, "impacts": 2, "coherence_m": 5.0}
    one, again, other = (simulated(seed=s, duration_s=4.0, **options) for s in (4, 4, 5))
    assert np.array_equal(values_of(one), values_of(again))
    assert np.array_equal(values_of(one), values_of(one))
    assert one.labels == again.labels
    assert one.labels != other.labels
    assert not np.array_equal(values_of(one), values_of(other))


def test_a_longer_recording_needs_no_more_memory():
    peaks = []
    for duration_s in (5.0, 25.0):
        blocks = simulated(duration_s=duration_s, coherence_m=5.0).sources[0][2]
        for _ in blocks:  # what is loaded once
            break
        tracemalloc.start()
        for _ in blocks:
            pass
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.2 * peaks[0]


def test_nothing_clips_by_itself():
    for seed in range(2):
        busy = simulated(seed=seed, duration_s=20.0, passes=2, impacts=3, coherence_m=3.0)
        samples = np.concatenate([b.samples for b in busy.sources[0][2]])
        assert np.abs(samples.astype(int)).max() < 32767


def test_steps_and_impacts_are_heard_when_truth_says():
    site = sensors_at((0.0, 0.0))
    far = simulated(geometry=site, offset_m=1000.0, impacts=4, duration_s=40.0, snr=100.0)
    values = values_of(far)[:, 0]
    for impact in of_kind(far, "impact"):
        x, y = (float(part) for part in impact.note[3:-2].split(", "))
        start = far.sources[0][2]
        first = next(iter(start)).anchor_ns
        heard = ((impact.time_ns - first) / 1e9 + np.hypot(x, y) / 250.0) * RATE
        before = np.abs(values[round(heard) - 40 : round(heard) - 2]).max()
        assert np.abs(values[round(heard) : round(heard) + 20]).max() > 5 * before


def test_default_options_pass_their_own_check():
    VehicleOptions().check()
