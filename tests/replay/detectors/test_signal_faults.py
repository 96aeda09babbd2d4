"""Faults of recorded signals: each is found where it was planted, and nothing where none was."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from planted_rooms import RATE, Room

from groundtrace.detectors.fault_scan import FaultScan
from groundtrace_codecs.events import Gap
from groundtrace_codecs.signals import NS_PER_S, Channel, SignalBlock, Stream

if TYPE_CHECKING:
    from collections.abc import Callable

    from groundtrace.detectors.signal_faults import Finding

#: About one standard deviation of the simulated noise [counts].
SIGMA = 4
TIME_S = np.arange(10 * RATE) / RATE


def found(room: Room, cut: int = RATE // 2) -> list[Finding]:
    """Return what a watch finds in a room's samples."""
    return watched(room.stream, room.samples, room.start_ns, cut)


def watched(stream: Stream, samples: np.ndarray, start_ns: int = 0, cut: int = 1000):
    watch = FaultScan(stream)
    for first in range(0, len(samples), cut):
        block = SignalBlock(stream, start_ns, first, samples[first : first + cut])
        watch.recorded(block)
        watch.update(block)
    return list(watch.findings())


def clipped(room: Room) -> None:
    room.samples[:, 2] = np.clip(room.samples[:, 2], -90, 90)


def at_full_scale(room: Room) -> None:
    loud = room.samples[:, 2].astype(np.int64) * 400
    room.samples[:, 2] = np.clip(loud, -32768, 32767)


def dead(room: Room) -> None:
    room.samples[3 * RATE : 6 * RATE, 2] = room.samples[3 * RATE, 2]


def dead_throughout(room: Room) -> None:
    room.samples[:, 2] = 0


def late(room: Room) -> None:
    room.samples[: 5 * RATE, 2] = 0


def spikes(room: Room) -> None:
    room.samples[[5 * RATE // 2, 9 * RATE // 2, 19 * RATE // 4], 2] += 20 * SIGMA


def dropout(room: Room) -> None:
    room.samples[3 * RATE : 3 * RATE + 400, 2] = 0


def short_dropout(room: Room) -> None:
    begin = round(3.06 * RATE)  # in a step, held at its last value
    room.samples[begin : begin + 20, 2] = room.samples[begin, 2]


def offset(room: Room) -> None:
    room.samples[5 * RATE :, 2] += 2 * SIGMA


def hum(room: Room) -> None:
    wave = SIGMA * np.sqrt(2) * np.sin(2 * np.pi * 50 * TIME_S)
    room.samples[:, 2] += np.rint(wave).astype(np.int16)


def hum_of_a_wrong_rate(room: Room) -> None:
    wave = sum(a * np.sin(2 * np.pi * 47 * n * TIME_S) for n, a in ((1, 5), (2, 2), (3, 2)))
    room.samples[:, 2] += np.rint(SIGMA * wave).astype(np.int16)


@pytest.mark.parametrize(
    ("plant", "kind", "first_s", "within_s", "events"),
    [
        (clipped, "clipped", 0.807, 0.01, 45),
        (at_full_scale, "clipped", 0.80, 0.02, None),
        (dead, "constant", 3.0, 0.001, 1),
        (dead_throughout, "constant", 0.0, 0.0, 1),
        (late, "late", 0.0, 0.0, 1),
        (spikes, "spikes", 2.5, 0.0001, 3),
        (dropout, "dropouts", 3.0, 0.001, 1),
        (short_dropout, "dropouts", 3.06, 0.001, 1),
        (offset, "offset", 5.0, 0.6, 1),
        (hum, "hum", 0.0, 0.0, 1),
        (hum_of_a_wrong_rate, "rate", 0.0, 0.0, 1),
    ],
)
def test_a_planted_fault_is_found_with_its_kind_channel_and_time(
    plant: Callable[[Room], None], kind: str, first_s: float, within_s: float, events: int | None
) -> None:
    room = Room()
    plant(room)
    (one,) = found(room)
    assert (one.channel, one.kind) == ("G3", kind)
    assert (one.start_ns - room.start_ns) / NS_PER_S == pytest.approx(first_s, abs=within_s + 1e-9)
    assert events in (one.events, None)
    assert all((one.what, one.effect, one.remedy))


def test_a_sound_recording_has_none_and_blocks_do_not_matter() -> None:
    room = Room()
    assert found(room) == []
    for plant in (clipped, dropout):
        plant(room)
    whole = found(room, len(room.samples))
    parts = found(room, 777)
    assert [(f.kind, f.start_ns, f.events) for f in parts] == [
        (f.kind, f.start_ns, f.events) for f in whole
    ]


def test_a_line_of_mains_at_47_hz_names_the_rate_that_would_put_it_at_50() -> None:
    room = Room()
    hum_of_a_wrong_rate(room)
    (one,) = found(room)
    assert "47.0" in one.what
    assert "-6.0 % off" in one.effect
    assert float(one.remedy.split("rate is ")[1].split(" Hz")[0]) == pytest.approx(21277, rel=1e-3)


def worn(samples: np.ndarray, rate_hz: float = 100.0) -> list[Finding]:
    channels = (Channel("ax", "acceleration", "m/s2", "x"),)
    return watched(Stream("/imu", channels, rate_hz), samples[:, None])


def swinging(seconds: float = 20.0) -> np.ndarray:
    """Return an acceleration of somebody walking [m/s2]."""
    time_s = np.arange(round(seconds * 100)) / 100
    rng = np.random.default_rng(1)
    wave = 3 * np.sin(2 * np.pi * 1.9 * time_s) + np.sin(2 * np.pi * 5.7 * time_s)
    return wave + rng.normal(0, 0.05, len(time_s))


def test_values_that_are_not_finite_are_counted_by_span() -> None:
    samples = swinging()
    samples[300:310], samples[700] = np.nan, np.inf
    (one,) = worn(samples)
    assert (one.kind, one.events, one.start_ns, one.end_ns) == (
        "not finite",
        2,
        3 * NS_PER_S,
        7_010_000_000,
    )
    assert one.share == pytest.approx(11 / 2000)


def test_a_worn_sensor_that_clips_drops_out_or_walks_is_told_apart() -> None:
    assert worn(swinging()) == []
    assert worn(np.round(swinging() / 0.04) * 0.04) == []  # 16 g in 13 bits
    (clip,) = worn(np.clip(swinging(), -2.5, 2.5))
    assert clip.kind == "clipped"
    held = swinging()
    held[505:520] = held[505]
    assert [(f.kind, f.events) for f in worn(held)] == [("dropouts", 1)]


@pytest.mark.parametrize(("ppm", "told"), [(0, False), (100, False), (2000, True), (-2000, True)])
def test_a_rate_that_the_times_contradict_is_told_with_the_one_they_say(
    ppm: float, told: bool
) -> None:
    stream = Stream("/seismic", (Channel("G1", "ground_velocity", "m/s"),), 1000.0)
    watch = FaultScan(stream)
    for k in range(200):
        anchor = round(k * 100 * (1e6 - 1e6 * ppm / (1e6 + ppm)))  # what 100 samples take, less
        watch.recorded(SignalBlock(stream, anchor - k * 100_000_000, k * 100, np.zeros((100, 1))))
    lines = [f for f in watch.findings() if f.kind == "rate"]
    assert len(lines) == int(told)
    if told:
        assert f"{1000 * (1 + ppm / 1e6):.6g} Hz" in lines[0].what


def test_runs_apart_are_judged_apart() -> None:
    stream = Stream("/imu", (Channel("ax", "acceleration", "m/s2", "x"),), 100.0)
    watch = FaultScan(stream)
    samples = swinging()[:, None]
    watch.update(SignalBlock(stream, 0, 0, samples[:1000]))
    watch.update(Gap("/imu", 10 * NS_PER_S, 15 * NS_PER_S, "missing", 500))
    watch.update(SignalBlock(stream, 15 * NS_PER_S, 0, samples[1000:] + 30))
    assert list(watch.findings()) == []
