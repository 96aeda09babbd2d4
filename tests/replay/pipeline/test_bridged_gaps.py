"""How long a gap may be that is filled: as the stages of a pipeline say."""

from __future__ import annotations

import numpy as np
import pytest

from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import load_pipeline
from groundtrace.pipeline.engine import EventList, replay
from groundtrace.pipeline.source import BRIDGE_S, Source
from groundtrace.simulate.recording import write
from groundtrace.simulate.road import VehicleOptions
from groundtrace.simulate.room import simulate_room
from groundtrace.simulate.room_plan import RoomOptions
from groundtrace.simulate.vehicle import simulate_vehicle
from groundtrace_codecs.events import Pass, StepEvent
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S
from groundtrace_codecs.writer import write_recording


@pytest.mark.parametrize(
    ("pipeline", "bridge_s"),
    [
        ("room-footsteps", 0.05),
        ("room-bearings", 0.05),
        ("vehicle-passes", 0.3),
        ("vehicle-tracks", 0.3),
        ("waist-steps", 0.3),
        ("pedestrian", 0.3),
        ("hammer-shots", BRIDGE_S),
        ("foot-inertial", BRIDGE_S),
    ],
)
def test_a_pipeline_takes_gaps_filled_as_long_as_all_of_its_stages_do(
    pipeline: str, bridge_s: float
) -> None:
    assert build_pipeline(load_pipeline(pipeline)).bridge_s == bridge_s


def without_packets(source, out, packet_s, every_s=1):
    with Recording.open(source) as recording:
        (stream,) = recording.streams
        (block,) = Source(recording, block_s=1e6)
        length = round(packet_s * stream.rate_hz)
        every = round(every_s * stream.rate_hz)
        starts = np.arange(every, len(block) - length, every)
        edges = [0, *np.column_stack([starts, starts + length]).ravel().tolist(), len(block)]
        parts = [block.slice(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True)]
        write_recording(
            out, [(stream, "f32le", parts)], geometry=recording.geometry, labels=recording.labels
        )
    return out


def test_lost_packets_of_a_room_make_no_steps(tmp_path) -> None:
    """A line of 90 ms lets the noise be forgotten, which then seems to begin: filled, it is one."""
    whole = tmp_path / "whole.mcap"
    write(simulate_room(RoomOptions(seed=3, steps=12)), whole)
    path = without_packets(whole, tmp_path / "lossy.mcap", 0.09)
    told = {}
    for bridge_s in (None, BRIDGE_S):
        sink = EventList()
        with Recording.open(path) as recording:
            chain = build_pipeline(load_pipeline("room-steps"), recording.geometry)
            source = Source(recording, bridge_s=chain.bridge_s if bridge_s is None else bridge_s)
            replay(source, chain, [sink])
            true = np.array([x.time_ns for x in recording.labels if x.kind == "step"])
        steps = [e.time_ns for e in sink.events if isinstance(e, StepEvent)]
        false = [t for t in steps if np.abs(true - t).min() > 0.12 * NS_PER_S]
        told[bridge_s] = len(false)
    assert told[None] == 0
    assert told[BRIDGE_S] > 0


def test_lost_packets_of_stations_end_no_vehicle(tmp_path) -> None:
    whole = tmp_path / "whole.mcap"
    write(simulate_vehicle(VehicleOptions(seed=5)), whole)
    path = without_packets(whole, tmp_path / "lossy.mcap", 0.2, every_s=5)
    moments = {}
    for name, file in (("whole", whole), ("lossy", path)):
        sink = EventList()
        with Recording.open(file) as recording:
            chain = build_pipeline(load_pipeline("vehicle-passes"), recording.geometry)
            replay(Source(recording, bridge_s=chain.bridge_s), chain, [sink])
        moments[name] = sorted(e.time_ns for e in sink.events if isinstance(e, Pass))
    assert len(moments["whole"]) == 6
    off_s = (np.array(moments["lossy"]) - moments["whole"]) / NS_PER_S
    assert np.abs(off_s).max() < 0.1
