"""Adaptive step detector: any rate, any way up, any place; silent while nobody walks."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from replay_blocks import START_NS
from scipy.spatial.transform import Rotation

from groundtrace.detectors.adaptive import AdaptiveDetector, AdaptiveParameters
from groundtrace.detectors.peaks import PeakDetector
from groundtrace.evaluation.steps import score_steps
from groundtrace.pipeline.conformance import check_stage, run
from groundtrace.pipeline.parameters import StageConfig
from groundtrace.pipeline.source import Source
from groundtrace.pipeline.stage import StageRunner
from groundtrace_codecs.events import Note
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S, Channel, SignalBlock, Stream
from groundtrace_recordings import path_of

RATES = (6.0, 10.0, 25.0, 31.7, 100.0, 400.0)
AXES = tuple(Channel(f"acc_{axis}", "acceleration", "m/s2", axis) for axis in "xyz")
G = 9.81


def walking(rate_hz, cadence_hz=1.8, duration_s=30.0, stride=0.3, swing=2.0):
    """Force of a walk between 5 s and the end minus 5 s, up along z, shape (n, 3)."""
    t = np.arange(round(duration_s * rate_hz)) / rate_hz
    phase = 2 * np.pi * cadence_hz * (t - 5.0)
    moving = (t > 5.0) & (t < duration_s - 5.0)
    up = swing * (np.sin(phase) + stride * np.sin(phase / 2 + 0.4))
    side = 0.5 * swing * np.sin(phase / 2)
    force = np.column_stack([np.where(moving, side, 0.0), np.zeros(len(t)), up * moving + G])
    return force + np.random.default_rng(3).normal(0, 0.02, force.shape)


def steps_of(samples, rate_hz, worn="phone", channels=AXES, **parameters):
    """Times of the steps [s]."""
    stream = Stream("/acc", channels, rate_hz, placement=worn)
    stage = StageRunner(
        StageConfig("adaptive", "steps"), AdaptiveDetector, AdaptiveParameters(**parameters)
    )
    found = run(stage, [SignalBlock(stream, START_NS, 0, samples)])
    return np.array([e.time_ns - START_NS for e in found.events]) / NS_PER_S


@pytest.mark.parametrize("rate_hz", RATES)
@pytest.mark.parametrize("placement", ["waist", "phone", "wrist"])
def test_every_step_is_counted_once_at_any_rate(rate_hz, placement):
    found = steps_of(walking(rate_hz), rate_hz, placement)
    assert abs(len(found) - 36) <= 1
    assert np.abs(np.diff(found) - 1 / 1.8).max() < 0.2
    assert found[0] > 4.9
    assert found[-1] < 25.2


@pytest.mark.parametrize("cadence_hz", [1.4, 1.8, 2.2, 2.6])
@pytest.mark.parametrize("stride", [0.0, 0.5, 1.0])
def test_every_cadence_is_counted_however_unequal_the_feet(cadence_hz, stride):
    found = steps_of(walking(50.0, cadence_hz, stride=stride), 50.0)
    assert abs(len(found) - 20 * cadence_hz) <= 2


@pytest.mark.parametrize("placement", ["waist", "wrist"])
@pytest.mark.parametrize("cadence_hz", [0.9, 1.0, 1.2, 1.3])
def test_a_slow_walk_is_counted_once_a_step(cadence_hz, placement):
    found = steps_of(walking(50.0, cadence_hz, duration_s=40.0, stride=0.1), 50.0, placement)
    assert abs(len(found) - 30 * cadence_hz) <= 2


@pytest.mark.parametrize("seed", range(4))
def test_the_way_the_sensor_is_turned_changes_nothing(seed):
    force = walking(100.0)
    turned = Rotation.random(random_state=seed).apply(force)
    np.testing.assert_allclose(steps_of(turned, 100.0), steps_of(force, 100.0), atol=1e-6)


def test_a_magnitude_in_unknown_units_counts_as_one_in_si():
    norm = np.linalg.norm(walking(25.0), axis=1)[:, None]
    plain = Channel("magnitude", "acceleration_magnitude", "m/s2")
    raw = Channel("magnitude", "acceleration_magnitude", "count")
    known = steps_of(norm, 25.0, "wrist", (plain,))
    unknown = steps_of(np.rint(norm * 2200), 25.0, "wrist", (raw,))
    assert len(known) == len(unknown) == pytest.approx(36, abs=1)


def test_a_run_of_any_length_is_judged_by_what_there_is():
    force = walking(50.0, duration_s=40.0)
    lengths = [len(steps_of(force[: round(s * 50)], 50.0, "waist")) for s in (0.02, 1, 6, 9, 14)]
    assert lengths[:2] == [0, 0]
    assert all(a <= b for a, b in pairwise(lengths))
    assert lengths[-1] >= 15


def still(t, rng):
    return np.zeros_like(t)


def handled(t, rng):
    """Single gestures some seconds apart."""
    begun = np.cumsum(rng.uniform(1.5, 6.0, 20))
    size = rng.uniform(1, 5, 20)
    return sum(a * np.exp(-(((t - b) / 0.25) ** 2)) for a, b in zip(size, begun, strict=True))


def busy(t, rng):
    """A hand at work: noise in the band of the steps."""
    spectrum = np.fft.rfft(rng.normal(0, 1, len(t)))
    hz = np.fft.rfftfreq(len(t), t[1])
    spectrum[(hz < 0.3) | (hz > 3.0)] = 0
    noise = np.fft.irfft(spectrum, len(t))
    return 1.5 * noise / noise.std()


def counted(movement, seed, **parameters):
    t = np.arange(60 * 50) / 50.0
    force = np.column_stack([0 * t, 0 * t, G + movement(t, np.random.default_rng(seed))])
    return len(steps_of(force, 50.0, "wrist", **parameters))


def test_a_sensor_at_rest_does_not_walk():
    assert counted(still, 0) == 0


@pytest.mark.parametrize(("movement", "part"), [(handled, 0.1), (busy, 0.3)])
def test_the_rhythm_keeps_most_of_what_is_no_walk_out(movement, part):
    peaks = sum(counted(movement, seed, rhythm=0.0) for seed in range(8))
    assert peaks > 8 * 12
    assert sum(counted(movement, seed) for seed in range(8)) < part * peaks


def test_a_sensor_that_is_turned_about_in_the_hand_takes_no_steps():
    """A figure of eight, as a compass is calibrated by, shakes as regularly as a walk does."""
    t = np.arange(30 * 50) / 50.0
    force = np.column_stack([0 * t, 0 * t, G + 2.0 * np.sin(2 * np.pi * 1.8 * t)])
    about = 1.2 * np.sin(2 * np.pi * t / 5.0)
    turned = Rotation.from_rotvec(np.outer(about, [1.0, 0.3, 0.0])).apply(force)
    assert len(steps_of(force, 50.0, "phone")) >= 50
    assert len(steps_of(turned, 50.0, "phone", tilt=180.0)) >= 25
    times = steps_of(turned, 50.0, "phone")
    # at the ends it is not known how it was turned before or is after
    assert not ((times > 4.5) & (times < 27.0)).any()


def test_who_turns_a_phone_up_and_down_while_walking_loses_no_step():
    """To and fro in eight seconds: a walk's rhythm stays what it is."""
    force = walking(50.0, duration_s=60.0)
    about = 0.6 * np.sin(2 * np.pi * np.arange(len(force)) / 50.0 / 8.0)
    turned = Rotation.from_rotvec(np.outer(about, [1.0, 0.0, 0.0])).apply(force)
    assert len(steps_of(turned, 50.0, "phone")) >= len(steps_of(force, 50.0, "phone")) - 1


def test_who_puts_a_phone_away_while_walking_loses_no_step():
    force = walking(50.0, duration_s=40.0)
    quarter = np.clip(np.arange(len(force)) / 50.0 - 20.0, 0, 1) * np.pi / 2
    turned = Rotation.from_rotvec(np.outer(quarter, [1.0, 0.0, 0.0])).apply(force)
    assert abs(len(steps_of(turned, 50.0, "phone")) - len(steps_of(force, 50.0, "phone"))) <= 2


def test_the_placement_may_be_given_where_the_recording_lacks_it():
    force = walking(50.0, duration_s=13.0)  # six steps
    said = steps_of(force, 50.0, "", placement="waist")
    np.testing.assert_array_equal(said, steps_of(force, 50.0, "waist"))


def bundled():
    with Recording.open(path_of("waist-walk.mcap")) as recording:
        items = list(Source(recording, topics=["/imu/waist"]))
        return items, recording.labels, recording.start_ns, recording.end_ns


def test_the_bundled_walk_is_found():
    items, labels, start_ns, end_ns = bundled()
    stage = StageRunner(StageConfig("adaptive", "steps"), AdaptiveDetector, AdaptiveParameters())
    times = np.array([e.time_ns for e in run(stage, items).events], np.int64)
    score = score_steps(labels, times, start_ns, end_ns)
    assert score.f1 >= 0.95
    assert abs(score.count_error_signed) <= 2


def test_it_conforms_in_blocks_of_any_size():
    items, *_ = bundled()
    found = check_stage(AdaptiveDetector, items[:40], block_sizes=(1, 7, 333))
    assert found.accepted.sum() > 10


@pytest.mark.parametrize("unit", ["count", "a.u."])
@pytest.mark.parametrize("turn_deg", [0.0, 40.0])
def test_axes_in_an_unknown_unit_are_walked_with_as_in_a_known_one(unit, turn_deg):
    force = Rotation.from_euler("xy", [turn_deg, turn_deg], degrees=True).apply(walking(100.0))
    channels = tuple(Channel(f"acc_{axis}", "acceleration", unit, axis) for axis in "xyz")
    found = steps_of(force * 1670.0, 100.0, channels=channels)
    assert abs(len(found) - 36) <= 1
    assert np.abs(np.diff(found) - 1 / 1.8).max() < 0.2


@pytest.mark.parametrize(
    ("kind", "level", "said"),
    [
        ("adaptive", "INFO", "its mean length is taken for gravity"),
        ("dp", "WARN", "what steps asks for in m/s2 does not hold"),
    ],
)
def test_a_unit_that_no_threshold_can_be_compared_with_is_told(kind, level, said):
    detector = {"adaptive": AdaptiveDetector, "dp": PeakDetector}[kind]
    channels = tuple(Channel(f"acc_{axis}", "acceleration", "a.u.", axis) for axis in "xyz")
    stage = StageRunner(StageConfig(kind, "steps"), detector, detector.Parameters())
    block = SignalBlock(Stream("/acc", channels, 100.0), START_NS, 0, walking(100.0))
    notes = [e for e in [*stage.process(block), *stage.flush()] if isinstance(e, Note)]
    assert [(n.level, n.text) for n in notes] == [
        (level, f"/acc: acceleration is in a.u., not m/s2: {said}")
    ]
