"""Where a sensor may be worn: the questions, the signal, and who says so."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from command_runs import done

from groundtrace.inertial.placement import Measures, PlacementGuess, PlacementWatch, guessed, noted
from groundtrace.pipeline.conformance import rechunked
from groundtrace_codecs.events import Gap, Note
from groundtrace_codecs.importers.run import import_recording
from groundtrace_codecs.signals import Channel, SignalBlock, Stream
from groundtrace_codecs.writer import write_recording
from groundtrace_recordings import map_path

if TYPE_CHECKING:
    from pathlib import Path

NS = 10**9
STILL = Measures(60.0, 2.0, 0.4, 0.3, 0.02, 6.0, 0.05, 0.1)


def limb(seconds: float = 40.0, rate_hz: float = 100.0, swing_deg: float = 25.0) -> np.ndarray:
    """Force and turning of a sensor that hangs on a limb swinging once a stride of 1.07 s."""
    t = np.arange(round(seconds * rate_hz)) / rate_hz
    stride = 2 * np.pi * t / 1.07
    angle = np.radians(swing_deg) * np.sin(stride)
    # the bob of the body along the limb, and the limb's own swing across it
    along = 9.81 * np.cos(angle) + 2.0 * np.cos(2 * stride)
    across = 9.81 * np.sin(angle)
    # right-handed: what is fixed in space goes by v x w in the sensor's axes
    turning = -np.gradient(angle, t)
    none = np.zeros_like(t)
    return np.stack([across, none, along, none, turning, none], axis=1)


def stance(seconds: float = 40.0, rate_hz: float = 100.0) -> np.ndarray:
    """Force and turning of a foot that stands for 0.4 of a stride of 1.1 s, and swings."""
    t = np.arange(round(seconds * rate_hz)) / rate_hz
    phase = (t / 1.1) % 1
    swing = np.where(phase > 0.4, np.sin(np.pi * (phase - 0.4) / 0.6), 0.0)
    ahead = np.where(phase > 0.4, -np.sin(2 * np.pi * (phase - 0.4) / 0.6), 0.0)
    none = np.zeros_like(t)
    return np.stack([15 * ahead, none, 9.81 + 12 * swing**3, none, 6 * swing, none], axis=1)


def blocks(samples: np.ndarray, placement: str = "", rate_hz: float = 100.0) -> list[SignalBlock]:
    channels = [Channel(f"acc_{a}", "acceleration", "m/s2", a) for a in "xyz"]
    channels += [Channel(f"gyr_{a}", "angular_velocity", "rad/s", a) for a in "xyz"]
    stream = Stream("/imu", tuple(channels[: samples.shape[1]]), rate_hz, placement)
    return [SignalBlock(stream, 1_700_000_000 * NS, 0, samples)]


def watched(items: list[SignalBlock]) -> PlacementGuess | None:
    watch = PlacementWatch(items[0].stream)
    for block in items:
        watch.update(block)
    return watch.guess()


@pytest.mark.parametrize(
    ("measures", "site"),
    [
        (STILL, "trunk"),
        (replace(STILL, face=1.0), "hand"),
        (replace(STILL, turning_radps=2.0, swinging_radps=1.6, tilt_deg=25.0, once=0.2), "pocket"),
        (replace(STILL, turning_radps=2.0, swinging_radps=1.6, tilt_deg=25.0, once=0.9), "wrist"),
        (
            replace(
                STILL,
                turning_radps=4.5,
                swinging_radps=3.0,
                rests=0.4,
                tilt_deg=30.0,
                swing_mps2=7.0,
            ),
            "foot",
        ),
        (
            replace(
                STILL,
                turning_radps=None,
                swinging_radps=None,
                rests=None,
                tilt_deg=30.0,
                swing_mps2=9.0,
            ),
            "foot",
        ),
        (
            replace(STILL, turning_radps=None, swinging_radps=None, rests=None, tilt_deg=22.0),
            "pocket",
        ),
        # it turns as fast as a foot, but never stands
        (
            replace(
                STILL, turning_radps=4.0, swinging_radps=3.5, rests=0.02, tilt_deg=50.0, once=0.9
            ),
            "wrist",
        ),
    ],
)
def test_each_question_has_its_measure(measures: Measures, site: str) -> None:
    assert guessed(measures).site == site


def test_the_nearer_a_threshold_the_less_sure() -> None:
    sure = [
        guessed(replace(STILL, turning_radps=None, swinging_radps=None, rests=None, tilt_deg=x))
        for x in (5, 10)
    ]
    assert sure[0].confidence > sure[1].confidence
    assert guessed(replace(STILL, face=0.7)).confidence == pytest.approx(0.5, abs=0.05)


def test_a_guess_contradicts_what_cannot_be_and_only_when_sure() -> None:
    foot = guessed(replace(STILL, swing_mps2=8.0, turning_radps=5.0, rests=0.4, tilt_deg=30.0))
    assert foot.confidence > 0.9
    assert foot.contradicts("waist")
    assert not foot.contradicts("foot")
    assert not foot.contradicts("")
    assert not foot.contradicts("left ear")
    assert not replace(foot, confidence=0.6).contradicts("waist")
    assert not guessed(replace(STILL, face=1.0)).contradicts("waist")
    assert not guessed(STILL).contradicts("phone")  # in a pouch on the breast


def test_a_limb_s_swing_and_a_foot_s_stance_are_told_from_the_signal() -> None:
    samples = limb()
    swinging, standing = watched(blocks(samples)), watched(blocks(stance()))
    assert swinging is not None
    assert swinging.site == "wrist"
    felt_deg = np.degrees(np.arctan2(samples[:, 0], samples[:, 2]))
    assert swinging.measures.tilt_deg == pytest.approx(np.sqrt(np.mean(felt_deg**2)), abs=0.5)
    turning = np.radians(25) * 2 * np.pi / 1.07 / np.sqrt(2)
    assert swinging.measures.turning_radps == pytest.approx(turning, rel=0.05)
    assert standing is not None
    assert standing.site == "foot"
    assert standing.measures.rests == pytest.approx(0.4, abs=0.1)


def test_without_a_gyroscope_it_is_guessed_from_the_force_alone() -> None:
    found = watched(blocks(limb()[:, :3]))
    assert found is not None
    assert found.measures.turning_radps is None
    assert found.site == "wrist"
    assert "turning" not in found.text


@pytest.mark.parametrize("size", [1, 37, 1000])
def test_blocks_of_any_size_give_the_same_guess(size: int) -> None:
    whole = blocks(limb(20.0))
    assert watched(list(rechunked(whole, size))) == watched(whole)


def test_rest_noise_a_short_walk_and_unknown_units_give_no_guess() -> None:
    rng = np.random.default_rng(5)
    lying = np.tile([0.0, 0.0, 9.81], (4000, 1))
    assert watched(blocks(lying)) is None
    assert watched(blocks(lying + rng.normal(0, 2.0, lying.shape))) is None
    assert watched(blocks(limb(9.0))) is None
    counts = tuple(Channel(f"a{a}", "acceleration", "count", a) for a in "xyz")
    assert not PlacementWatch.fits(Stream("/imu", counts, 50.0))
    assert not PlacementWatch.fits(Stream("/imu", counts[:2], 50.0))


def test_more_than_two_minutes_of_walking_change_nothing() -> None:
    watch = PlacementWatch(blocks(limb(1.0))[0].stream)
    for block in rechunked(blocks(limb(130.0, 50.0), rate_hz=50.0), 50):
        watch.update(block)
    assert watch.done
    found = watch.guess()
    assert found is not None
    assert found.measures.walked_s == 120.0


def test_a_replay_s_notes_say_where_nothing_was_stated_or_something_else() -> None:
    def said(placement: str) -> list[Note]:
        items = list(rechunked(blocks(limb(swing_deg=40.0), placement), 50))
        found = list(
            noted([*items, Gap("/other", items[-1].last_ns, items[-1].last_ns, "missing", 0)])
        )
        assert [x for x in found if isinstance(x, SignalBlock)] == items
        return [x for x in found if isinstance(x, Note)]

    (unstated,) = said("")
    assert unstated.level == "INFO"
    assert "no placement stated" in unstated.text
    assert "swinging wrist" in unstated.text
    (other,) = said("waist")
    assert other.level == "WARN"
    assert "placement waist stated and taken, but it moves like: swinging wrist" in other.text
    assert not said("wrist")


def test_info_and_replay_show_the_guess(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    items = blocks(limb(swing_deg=40.0), "waist")
    write_recording("walk.mcap", [(items[0].stream, "f32le", items)])
    text = done(capsys, "info", "walk.mcap").out
    assert "placement of /imu, a guess: swinging wrist (" in text
    assert "stated: waist, which is taken" in text
    (stream,) = done(capsys, "info", "walk.mcap", "--json").document["streams"]
    assert stream["placement"] == "waist"
    assert stream["placement_guess"]["placement"] == "wrist"
    assert stream["placement_guess"]["contradicts"] is True
    ran = done(capsys, "replay", "walk.mcap", "--no-viewer", "--json").document
    assert ran["events"]["notes"] == 1


@pytest.mark.parametrize(
    ("source", "map_name", "site"),
    [
        ("xio-gait/short_walk.csv", "xio-gait.toml", "foot"),
        ("mobgap/MS/001/data.mat", "mobgap-test11.toml", "trunk"),
        ("oxford-step/validation/user1_hand_*.csv", "oxford-step-validation.toml", "hand"),
        ("oxford-step/validation/user1_backpocket_*.csv", "oxford-step-validation.toml", "pocket"),
    ],
)
def test_real_recordings_are_guessed(
    data: Path, tmp_path: Path, source: str, map_name: str, site: str
) -> None:
    from groundtrace.pipeline.source import Source
    from groundtrace_codecs.recording import Recording

    path = tmp_path / "walk.mcap"
    (found,) = data.glob(source)
    import_recording([found], path, map_path=map_path(map_name))
    with Recording.open(path) as opened:
        stream = next(s for s in opened.streams if PlacementWatch.fits(s))
        watch = PlacementWatch(stream)
        for item in Source(opened, topics=[stream.topic]):
            watch.update(item) if isinstance(item, SignalBlock) else watch.gap()
    guess = watch.guess()
    assert guess is not None
    assert guess.site == site
    assert not guess.contradicts(stream.placement)
