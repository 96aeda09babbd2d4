"""A small simulated shot record: two shots on four geophones, and two stages that pick."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from viewer_sessions import FIRST_BREAKS, NAMES, SEISMIC, SPEC, at, blocks, room_session

from groundtrace_codecs.events import Label, Pick
from groundtrace_codecs.geometry import Geometry, Sensor
from groundtrace_viewers.rerun.sink import RerunSink

if TYPE_CHECKING:
    from pathlib import Path

    from groundtrace.pipeline.engine import ReplaySession

SHOTS_S = (1.0, 3.5)
#: Samples between a shot and its arrival at a channel, and between channels.
FIRST, MOVEOUT = 40, 20


def shot_samples() -> np.ndarray:
    """Arrivals a thousand times weaker at the last channel, shape (n, 4), int32 as stored."""
    x = np.zeros((10_000, 4), np.int32)
    t = np.arange(200) / SEISMIC.rate_hz
    wave = np.exp(-t / 0.02) * np.sin(2 * np.pi * 50 * t)
    for shot in SHOTS_S:
        for c in range(4):
            first = int(shot * SEISMIC.rate_hz) + FIRST + MOVEOUT * c
            x[first : first + len(wave), c] = np.round(wave * 10.0 ** (6 - c))
    return x


def arrival(shot_s: float, channel: int) -> int:
    """Time of an arrival [ns]."""
    return at(shot_s + (FIRST + MOVEOUT * channel) / SEISMIC.rate_hz)


def shot_labels() -> tuple[Label, ...]:
    """Shots at places, and hand picks."""
    impacts = [Label(at(s), "impact", x_m=-2.0, y_m=0.0) for s in SHOTS_S]
    picks = [
        Label(arrival(s, c), "pick", channel=name) for s in SHOTS_S for c, name in enumerate(NAMES)
    ]
    return tuple(sorted([*impacts, *picks]))


def shots_session(labels: tuple[Label, ...]) -> ReplaySession:
    """A line of geophones."""
    line = Geometry(tuple(Sensor(n, n, 2.0 * i, 0.0) for i, n in enumerate(NAMES)))
    session = room_session("shots.mcap")
    return replace(session, application="shots", streams=(SEISMIC,), geometry=line, labels=labels)


def write_shots(path: Path, labels: tuple[Label, ...], rows: int = 1000) -> Path:
    """Write the replay: ten picks of noise per true one come before the stage that chooses."""
    sink = RerunSink(path)
    sink.open(shots_session(labels))
    sink.write(SPEC)
    sink.write(FIRST_BREAKS)
    for block in blocks(SEISMIC, shot_samples(), rows):
        sink.write(block)
    for shot in SHOTS_S:
        for c, name in enumerate(NAMES):
            pick = Pick(arrival(shot, c), name, "/seismic", "picker", 4e-4, 9.0)
            for late in range(10):
                sink.write(replace(pick, time_ns=pick.time_ns + late * 7_000_000))
            sink.write(replace(pick, stage="first-breaks"))
    sink.close()
    return path
