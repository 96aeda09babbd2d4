"""Dead reckoning with a sensor at the waist that is turned about the vertical by any angle."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from groundtrace.inertial.pdr import DeadReckoning
from groundtrace.inertial.steps import ReckoningParameters
from groundtrace.pipeline.parameters import StageConfig
from groundtrace.pipeline.stage import StageRunner
from groundtrace.simulate.gait import WalkOptions
from groundtrace.simulate.walk import simulate_walk
from groundtrace_codecs.events import Heading, Note, StageSpec, StepEvent, TrackPoint
from groundtrace_codecs.signals import SignalBlock

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from groundtrace.simulate.recording import Simulation
    from groundtrace_codecs.events import Event

TOPIC = "/imu/waist"
SPEC = StageSpec("steps", "x", TOPIC, ("up",), (), (), (), "step")
#: How far off a walk of 35 m may end whose steps, and their mean length, are known.
TOLERANCE_M = 1.0


@cache
def walk() -> Simulation:
    """A walk to the east and round a corner to the north."""
    return simulate_walk(WalkOptions(path="l", seed=3, rate_hz=50.0))


def steps() -> list[StepEvent]:
    found = [x.time_ns for x in walk().labels if x.kind == "step"]
    return [StepEvent(x, "step", "", TOPIC, "steps", 1.0) for x in found]


def places() -> NDArray[np.float64]:
    """True places of the steps, shape (n, 2) [m]."""
    return np.array([(x.x_m, x.y_m) for x in walk().labels if x.kind == "step"])


def length_m() -> float:
    return float(np.hypot(*np.diff(places(), axis=0).T).mean())


def blocks(turned_deg: float, size: int = 25) -> list[SignalBlock]:
    """What the sensor says, mounted so much further to the left, in order of time."""
    mount = Rotation.from_euler("Z", turned_deg, degrees=True).inv()
    found = []
    for stream, _, parts in walk().sources:
        values = np.concatenate([b.values for b in parts])
        if stream.topic.startswith("/baro"):
            continue
        triples = [mount.apply(values[:, k : k + 3]) for k in range(0, values.shape[1], 3)]
        start_ns = next(iter(parts)).start_ns
        whole = SignalBlock(stream, start_ns, 0, np.hstack(triples))
        found += [whole.slice(k, min(k + size, len(whole))) for k in range(0, len(whole), size)]
    return sorted(found, key=lambda b: b.last_ns)


def reckoned(given: Iterable[SignalBlock], **parameters: str) -> list[Event]:
    p = replace(
        ReckoningParameters(step_length="fixed", length_m=length_m()),
        **parameters,  # type: ignore[arg-type]
    )
    stage = StageRunner(
        StageConfig("reckoning", "track"), DeadReckoning, p, {DeadReckoning.takes[0]: ("steps",)}
    )
    waiting, out = steps(), list(stage.process(SPEC))
    for block in given:
        out += stage.process(block)
        while waiting and waiting[0].time_ns + 2 * 10**9 <= block.last_ns:
            out += stage.process(waiting.pop(0))
    for step in waiting:
        out += stage.process(step)
    return out + list(stage.flush())


@cache
def turned(turned_deg: float) -> tuple[Event, ...]:
    return tuple(reckoned(blocks(turned_deg)))


def ways(events: Iterable[Event], stage: str = "track") -> NDArray[np.float64]:
    """Places at the steps against the one at the first, shape (n, 2) [m]."""
    found = [(e.x_m, e.y_m) for e in events if isinstance(e, TrackPoint) and e.stage == stage]
    return np.array(found[1:]) - found[1]


@pytest.mark.parametrize("turned_deg", [0.0, 90.0, 180.0, -130.0])
def test_a_turned_sensor_ends_where_one_that_looks_ahead_does(turned_deg: float) -> None:
    true = places() - places()[0]
    for stage in ("track", "track.smoothed"):
        end = ways(turned(turned_deg), stage)[-1]
        assert math.dist(end, true[-1]) < TOLERANCE_M


@pytest.mark.parametrize("turned_deg", [90.0, 180.0, -130.0])
def test_steps_before_the_walk_has_told_the_axis_are_gone_again(turned_deg: float) -> None:
    true = places() - places()[0]
    smooth = ways(turned(turned_deg), "track.smoothed")
    assert np.hypot(*(smooth - true).T).max() < TOLERANCE_M
    assert np.hypot(*(ways(turned(turned_deg)) - true)[10:].T).max() < 2 * TOLERANCE_M


def test_steps_carry_the_azimuth_of_the_way() -> None:
    azimuths = [math.degrees(e.heading_rad) for e in turned(180.0) if isinstance(e, Heading)]
    assert np.abs(azimuths[10:25]).max() < 10.0
    assert azimuths[-1] == pytest.approx(90.0, abs=10.0)


def test_a_named_axis_is_taken_at_its_word() -> None:
    way = ways(reckoned(blocks(180.0), axis="x"))
    true = places() - places()[0]
    assert math.dist(way[-1], -true[-1]) < 8.0


def test_what_the_walk_tells_is_said_once() -> None:
    notes = [e.text for e in turned(90.0) if isinstance(e, Note)]
    assert sum("of the sensor's x" in text for text in notes) == 1


@pytest.mark.parametrize("size", [7, 1000])
def test_the_track_of_a_turned_sensor_is_the_same_whatever_the_blocks(size: int) -> None:
    other = ways(reckoned(blocks(180.0, size)), "track.smoothed")
    np.testing.assert_allclose(other, ways(turned(180.0), "track.smoothed"), atol=1e-9)
