"""A small simulated session: four geophones, a waist sensor, a detector and its decisions."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from groundtrace.pipeline.engine import ReplaySession
from groundtrace_codecs.events import (
    CandidateBlock,
    Event,
    Gap,
    GateSpec,
    Label,
    Note,
    Pick,
    Quantity,
    StageSpec,
    StepEvent,
    TraceBlock,
)
from groundtrace_codecs.geometry import Geometry, Sensor
from groundtrace_codecs.signals import Channel, SignalBlock, Stream
from groundtrace_viewers.rerun.sink import RerunSink

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

START_NS = 1_750_000_000_123_456_789
RATE_HZ = 2000.0
IMU_RATE_HZ = 100.0
SECONDS = 6
STEPS_S = (0.8, 1.4, 2.0, 2.6, 3.2, 3.8, 4.4, 5.0)
NAMES = ("G1", "G2", "G3", "G4")
CORNERS = ((0.0, 0.0), (6.0, 0.0), (6.0, 5.0), (0.0, 5.0))

SEISMIC = Stream(
    "/seismic", tuple(Channel(n, "ground_velocity", "m/s", "z", 2e-9) for n in NAMES), RATE_HZ
)
QUANTITIES = {"acceleration": "m/s2", "angular_velocity": "rad/s", "magnetic_field": "T"}
IMU = Stream(
    "/imu/waist",
    (
        *(
            Channel(f"{q[:3]}_{axis}", q, unit, axis)
            for q, unit in QUANTITIES.items()
            for axis in "xyz"
        ),
        Channel("baro", "pressure", "Pa"),
    ),
    IMU_RATE_HZ,
    "waist",
)
ASSOCIATE = StageSpec("associate", "coincidence", "/seismic", ("all",), (), (), (), "step")
SPEC = StageSpec(
    "picker",
    "sta-lta",
    "/seismic",
    NAMES,
    (Quantity("ratio", "1"), Quantity("peak", "m/s")),
    (GateSpec("ratio", "1", "ratio", 4.0), GateSpec("peak", "m/s", "ratio", 1e-6)),
    (Quantity("ratio", "1"), Quantity("peak", "m/s")),
    "pick",
)
FIRST_BREAKS = StageSpec("first-breaks", "first-breaks", "/seismic", NAMES, (), (), (), "pick")


def at(seconds: float) -> int:
    """Time of a moment of the session [ns]."""
    return START_NS + round(seconds * 1e9)


def seismic_samples() -> np.ndarray:
    """Noise and footsteps, shape (n, 4), int32 as stored."""
    rng = np.random.default_rng(7)
    n = int(SECONDS * RATE_HZ)
    x = rng.normal(0.0, 200.0, (n, 4))
    t = np.arange(int(0.25 * RATE_HZ)) / RATE_HZ
    wave = np.exp(-t / 0.04) * np.sin(2 * np.pi * 32 * t)
    for k, step in enumerate(STEPS_S):
        for c in range(4):
            first = int((step + 0.005 * c) * RATE_HZ)
            x[first : first + len(wave), c] += wave * (9000 - 1500 * ((c + k) % 4))
    return np.round(x).astype(np.int32)


def imu_samples() -> np.ndarray:
    """A walk at 1.7 steps a second, shape (n, 10), in SI units."""
    t = np.arange(int(SECONDS * IMU_RATE_HZ)) / IMU_RATE_HZ
    phase = 2 * np.pi * 1.7 * t
    acceleration = [0.5 * np.sin(phase / 2), np.cos(phase), 9.81 + 2 * np.sin(phase)]
    turning = [0.3 * np.sin(phase), 0.2 * np.cos(phase), 0.1 * np.sin(phase / 2)]
    field = [2e-5 * np.cos(t / 5), 2e-5 * np.sin(t / 5), np.full_like(t, -4e-5)]
    return np.column_stack([*acceleration, *turning, *field, 101_300 - t])


def truth() -> tuple[Label, ...]:
    """Steps at places, and the span of the walk."""
    steps = [
        Label(at(s), "step", x_m=1 + 0.5 * k, y_m=2.0 + 0.2 * k, label="right" if k % 2 else "left")
        for k, s in enumerate(STEPS_S)
    ]
    return (*steps, Label(at(0.5), "walking", end_ns=at(5.5)))


def room_session(name: str = "room.mcap") -> ReplaySession:
    """Geophones in a room."""
    sensors = tuple(Sensor(n, n, x, y) for n, (x, y) in zip(NAMES, CORNERS, strict=True))
    geometry = Geometry(sensors, CORNERS, (1.0, 2.0), (("S1", 3.0, 2.5),))
    end = at(SECONDS) - round(SEISMIC.period_ns)
    return ReplaySession(name, "room", START_NS, end, (SEISMIC, IMU), geometry, truth(), "")


def walker_session(name: str = "waist.mcap") -> ReplaySession:
    """A waist sensor alone: no places."""
    labels = tuple(replace(x, x_m=None, y_m=None) for x in truth())
    return replace(
        room_session(name), application="walker", streams=(IMU,), geometry=None, labels=labels
    )


def blocks(
    stream: Stream, samples: np.ndarray, rows: int, lost: tuple[int, int] = (0, 0)
) -> Iterator[SignalBlock]:
    """Cut samples into blocks; rows of the half-open span ``lost`` are missing."""
    runs = [(0, lost[0]), (lost[1], len(samples))] if lost[1] else [(0, len(samples))]
    for first, last in runs:
        anchor = START_NS + round(first * stream.period_ns)
        for start in range(first, last, rows):
            piece = samples[start : min(start + rows, last)]
            yield SignalBlock(stream, anchor, start - first, piece)


def decisions() -> Iterator[Event]:
    """A trace, candidates near every step, and the events of the accepted ones."""
    frames = np.arange(SECONDS * 20, dtype=np.int64) * 50_000_000 + START_NS
    ratio = 1.0 + np.random.default_rng(3).random((len(frames), 4, 2)).astype(np.float32)
    times, channels, values = [], [], []
    for k, step in enumerate(STEPS_S):
        for c in range(4):
            level = 3.0 if k == 2 else 6.0 + c
            times.append(at(step + 0.005 * c))
            channels.append(c)
            values.append((level, 5e-6))
            ratio[int(step * 20), c, 0] = level
    measured = np.array(values, np.float32)
    margin = measured - np.array([4.0, 1e-6], np.float32)
    accepted = (margin >= 0).all(axis=1)
    yield SPEC
    yield ASSOCIATE
    yield TraceBlock(SPEC, frames, ratio)
    yield CandidateBlock(
        SPEC, np.array(times), np.array(channels, np.int32), measured, measured, margin, accepted
    )
    for time, channel, (level, _), good in zip(times, channels, values, accepted, strict=True):
        if good:
            yield Pick(time, NAMES[channel], "/seismic", "picker", 4e-4, level)
    for k, step in enumerate(STEPS_S):
        if k != 2:
            yield StepEvent(at(step), "step", "", "/seismic", "associate", 9.0, 4)
    yield Gap("/imu/waist", at(3.0), at(3.0), "clock step", 0)
    yield Note(at(1.0), "noise rose on G4", "WARN", "picker")


def write_room(path: Path, rows: int = 1000, lost: tuple[int, int] = (0, 0)) -> Path:
    """Write the room's replay."""
    sink = RerunSink(path)
    sink.open(room_session())
    for block in blocks(SEISMIC, seismic_samples(), rows, lost):
        sink.write(block)
    for block in blocks(IMU, imu_samples(), 50):
        sink.write(block)
    for event in decisions():
        sink.write(event)
    sink.close()
    return path


def write_walker(path: Path) -> Path:
    """Write the walker's replay: no detector, no events."""
    sink = RerunSink(path)
    sink.open(walker_session())
    for block in blocks(IMU, imu_samples(), 50):
        sink.write(block)
    sink.close()
    return path


def write_walk(path: Path, labels: tuple[Label, ...], *items: Event | SignalBlock) -> Path:
    """Write a walker's events into a viewer's file."""
    sink = RerunSink(path)
    sink.open(replace(walker_session(), labels=labels))
    for item in items:
        sink.write(item)
    sink.close()
    return path


def read_back(path: Path, entity: str, component: str) -> tuple[np.ndarray, list]:
    """Return the times [ns] and values of one component of an entity, in time order."""
    import pyarrow as pa
    import rerun as rr

    times, values = [], []
    for chunk in rr.chunk.RrdReader(str(path)).stream().filter(content=entity):
        batch = chunk.to_record_batch()
        if chunk.is_static or component not in batch.schema.names:
            continue
        times += batch.column("t").cast(pa.int64()).to_pylist()
        values += batch.column(component).to_pylist()
    order = np.argsort(np.array(times, np.int64), kind="stable")
    return np.array(times, np.int64)[order], [values[i] for i in order]
