"""A road, three stations beside it, two vehicles that meet, and what stages say of them."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from viewer_sessions import START_NS, at, room_session

from groundtrace_codecs.events import (
    CandidateBlock,
    GateSpec,
    Label,
    LineCrossing,
    Pass,
    Quantity,
    StageSpec,
    TraceBlock,
    TrackPoint,
)
from groundtrace_codecs.geometry import Geometry, Sensor
from groundtrace_codecs.signals import Channel, Stream
from groundtrace_viewers.rerun.sink import RerunSink

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from groundtrace.pipeline.engine import ReplaySession
    from groundtrace_codecs.events import Event

STATIONS = {"S1": 0.0, "S2": 20.0, "S3": 40.0}
#: The road begins so far before the first station [m].
BEFORE_M = 100.0
#: When a vehicle is at the first station [s], and its speed [m/s].
DRIVES = {"V1": (10.0, 10.0), "V2": (15.0, -8.0)}
STREAM = Stream(
    "/seismic",
    tuple(Channel(name, "ground_velocity", "m/s", "z", 1e-9) for name in STATIONS),
    100.0,
)
RECIPE = """
name = "p"
application = "vehicle"
[[stage]]
name = "presence"
use = "vehicle-presence"
[[stage]]
name = "ratios"
use = "vehicle-ratios"
[stage.parameters]
exponent = 2.0
[[stage]]
name = "passes"
use = "vehicle-passes"
[[stage]]
name = "course"
use = "vehicle-course"
"""
GATES = (GateSpec("over_floor", "dB", "o", 5.0), GateSpec("cadence", "1", "c", 0.5, False))
PRESENCE = StageSpec(
    "presence", "vehicle-presence", "/seismic", tuple(STATIONS),
    (Quantity("over_floor", "dB"), Quantity("cadence", "1")), GATES,
    (Quantity("over_floor", "dB"),), "presence",
)  # fmt: skip
ESTIMATES = tuple(
    Quantity(name, "ln")
    for estimator in ("likelihood", "geometric")
    for name in (estimator, f"{estimator} sigma")
)
RATIOS = StageSpec(
    "ratios", "vehicle-ratios", "/seismic", ("S2/S1", "S3/S1"), (), (), ESTIMATES, "fix"
)


def stage(name: str, emits: str) -> StageSpec:
    return StageSpec(name, name, "/seismic", ("all",), (), (), (), emits)


def truth() -> tuple[Label, ...]:
    """Two vehicles: places every second along 200 m, and their passes."""
    labels = []
    for name, (first_s, speed) in DRIVES.items():
        way = "forward" if speed > 0 else "backward"
        for second in range(30):
            x = (second - first_s) * speed
            if -BEFORE_M < x < BEFORE_M:
                labels.append(Label(at(second), "waypoint", x_m=x, y_m=5.0, target=name))
        for station, x in STATIONS.items():
            labels.append(
                Label(
                    at(first_s + x / speed),
                    "pass",
                    x_m=x,
                    y_m=5.0,
                    value=abs(speed),
                    channel=station,
                    label=way,
                    target=name,
                )
            )
    return tuple(labels)


def vehicle_session(*, placed: bool = True) -> ReplaySession:
    sensors = tuple(Sensor(name, name, x, 0.0) for name, x in STATIONS.items())
    geometry = Geometry(sensors, road=((-BEFORE_M, 5.0), (140.0, 5.0))) if placed else None
    return replace(
        room_session("cars.mcap"), application="vehicle", streams=(STREAM,), geometry=geometry,
        labels=truth(), pipeline=RECIPE, end_ns=START_NS + 30 * 10**9,
    )  # fmt: skip


def passes(*left_out: tuple[int, str]) -> list[Pass]:
    """Return what a stage says of both vehicles, less some (vehicle, station)."""
    found = [
        Pass(
            at(first_s + x / speed + 0.05), 0.04, station, number,
            "forward" if speed > 0 else "backward", abs(speed), 0.4, 0.5, 20.0, "passes",
        )
        for number, (first_s, speed) in enumerate(DRIVES.values(), 1)
        for station, x in STATIONS.items()
        if (number, station) not in left_out
    ]  # fmt: skip
    return sorted(found, key=lambda p: p.time_ns)


def course(name: str, track: int = 1) -> list[TrackPoint]:
    """Return a course along the road at 10 m/s, 5 s long."""
    spread = (1.0, 0.0, 0.25)
    return [
        TrackPoint(at(10 + i / 2), track, 5.0 * i, 5.0, 10.0, 0.0, spread, name) for i in range(11)
    ]


def crossing(name: str) -> LineCrossing:
    return LineCrossing(at(12), 0.05, 1, "S1-S3", 20.0, 0.0, 0.3, 10.0, 0.3, 0.1, name)


def cycles(verdicts: Sequence[tuple[float, float]]) -> CandidateBlock:
    """Return decided cycles of S1, half a second each: power over the floor [dB], cadence."""
    value = np.array(verdicts, np.float32)
    margin = (value - (5.0, 0.5)) * (1.0, -1.0)
    times = np.array([at(i / 2 + 0.25) for i in range(len(value))], np.int64)
    return CandidateBlock(
        PRESENCE, times, np.zeros(len(value), np.int32), value, value,
        margin.astype(np.float32), (margin >= 0).all(axis=1),
    )  # fmt: skip


def ratios(second: float) -> TraceBlock:
    value = np.log(np.array([[[2.0, np.e**0.1] * 2, [4.0, np.e**0.2] * 2]], np.float32))
    return TraceBlock(RATIOS, np.array([at(second)], np.int64), value)


def written(path: Path, session: ReplaySession, *events: Event) -> Path:
    """Write events into a viewer's file."""
    sink = RerunSink(path)
    sink.open(session)
    for event in events:
        sink.write(event)
    sink.close()
    return path
