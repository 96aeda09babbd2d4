"""The stage of dead reckoning on a made-up walker with a level phone."""

from __future__ import annotations

import copy
import math
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from groundtrace.errors import PipelineError
from groundtrace.inertial.pdr import DeadReckoning
from groundtrace.inertial.steps import ReckoningParameters
from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import parse_pipeline
from groundtrace.pipeline.parameters import StageConfig
from groundtrace.pipeline.stage import StageRunner
from groundtrace_codecs.events import (
    CandidateBlock,
    Event,
    Gap,
    Heading,
    Label,
    Note,
    StageSpec,
    StepEvent,
    TrackPoint,
)
from groundtrace_codecs.signals import NS_PER_S, Channel, SignalBlock, Stream

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

RATE_HZ, STEP_S, LENGTH_M = 50.0, 0.5, 0.7
P = ReckoningParameters(step_length="fixed", length_m=LENGTH_M, mount_deg=1.0)
SPEC = StageSpec("steps", "x", "/acc", ("up",), (), (), (), "step")
Item = SignalBlock | Event


def triple(topic: str, quantity: str, unit: str) -> Stream:
    return Stream(
        topic, tuple(Channel(f"{quantity}_{a}", quantity, unit, a) for a in "xyz"), RATE_HZ, "phone"
    )


FORCE = triple("/acc", "acceleration", "m/s2")
TURNING = triple("/gyro", "angular_velocity", "rad/s")
FIELD = triple("/mag", "magnetic_field", "T")
PLACE = Stream(
    "/gnss",
    (Channel("lat", "latitude", "deg"), Channel("lon", "longitude", "deg")),
    1.0,
)


def headings(seconds: float, corners_s: Sequence[float]) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Heading of the phone's y axis: east, and turned to the left by a corner each."""
    t = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    return sum((np.pi / 2 * np.clip(t - corner, 0, 1) for corner in corners_s), 0 * t)


def signal(
    seconds: float = 30.0, corners_s: Sequence[float] = (15.0,), field: bool = True
) -> list[SignalBlock]:
    """A phone's level signal in blocks of half a second, topics in turn."""
    turned = headings(seconds, corners_s)
    n = len(turned)
    t = np.arange(n) / RATE_HZ
    bob = 3 * np.cos(2 * np.pi * t / STEP_S)
    force = np.stack([0 * t, 0 * t, 9.80665 + bob], axis=1)
    rate = np.stack([0 * t, 0 * t, np.gradient(turned, 1 / RATE_HZ)], axis=1)
    # the phone's y axis is the heading, its x axis to the right of it
    north = np.stack([-np.cos(turned), np.sin(turned), -2 + 0 * t], axis=1) * 2e-5
    blocks = []
    size = round(RATE_HZ / 2)
    for first in range(0, n, size):
        given = ((FORCE, force), (TURNING, rate), *(((FIELD, north),) if field else ()))
        blocks += [SignalBlock(s, 0, first, v[first : first + size]) for s, v in given]
    return blocks


def steps(seconds: float = 30.0, kind: str = "") -> list[StepEvent]:
    times = np.arange(2.0, seconds - 1, STEP_S)
    return [
        StepEvent(round(x * NS_PER_S), "step", "", "/acc", "steps", 1.0, type=kind) for x in times
    ]


def items(blocks: Sequence[SignalBlock], found: Sequence[StepEvent]) -> list[Item]:
    """Every step comes 2 s after its time, as from a detector that looks around."""
    out: list[Item] = [SPEC]
    waiting = list(found)
    for block in blocks:
        while waiting and waiting[0].time_ns + 2 * NS_PER_S <= block.start_ns:
            out.append(waiting.pop(0))
        out.append(block)
    return out + list(waiting)


def stage(parameters: ReckoningParameters = P, labels: Sequence[Label] = ()) -> StageRunner:
    sources = {DeadReckoning.takes[0]: ("steps",)}
    config = StageConfig("reckoning", "track")
    return StageRunner(config, DeadReckoning, parameters, sources, labels=labels)


def run(made: StageRunner, given: Iterable[Item]) -> list[Event]:
    return [e for item in given for e in made.process(item)] + list(made.flush())


@cache
def plain() -> tuple[Event, ...]:
    """What the stage says of the walk with a corner."""
    return tuple(run(stage(), items(signal(), steps())))


def points(events: Iterable[Event], name: str = "track") -> list[TrackPoint]:
    return [e for e in events if isinstance(e, TrackPoint) and e.stage == name]


def test_a_walker_goes_east_and_then_north() -> None:
    events = plain()
    found = points(events)
    count = len(steps())
    assert len(found) == count + 1
    assert (found[0].x_m, found[0].y_m) == (0, 0)
    assert found[-1].x_m == pytest.approx(LENGTH_M * 28, abs=1.0)
    assert found[-1].y_m == pytest.approx(LENGTH_M * 26, abs=1.0)
    assert len(points(events, "track.smoothed")) == count + 1
    azimuths = [e.heading_rad for e in events if isinstance(e, Heading)]
    assert azimuths[5] == pytest.approx(0, abs=0.02)
    assert azimuths[-1] == pytest.approx(np.pi / 2, abs=0.03)


def test_velocities_and_growing_covariances_come_with_the_points() -> None:
    found = points(run(stage(), items(signal(corners_s=()), steps())))
    assert math.isnan(found[0].vx_mps)
    assert found[20].vx_mps == pytest.approx(LENGTH_M / STEP_S, abs=0.02)
    spreads = [p.covariance[0] + p.covariance[2] for p in found]
    assert (np.diff(spreads) > 0).all()


@pytest.mark.parametrize("size", [3, 1000])
def test_the_track_is_the_same_whatever_the_blocks(size: int) -> None:
    whole = plain()
    cut = [
        block.slice(k, min(k + size, len(block)))
        for block in signal()
        for k in range(0, len(block), size)
    ]
    other = run(stage(), items(cut, steps()))
    assert [(p.time_ns, p.x_m, p.y_m) for p in points(other)] == [
        (p.time_ns, pytest.approx(p.x_m, abs=1e-9), pytest.approx(p.y_m, abs=1e-9))
        for p in points(whole)
    ]
    smooth = [points(e, "track.smoothed") for e in (whole, other)]
    assert [p.time_ns for p in smooth[0]] == [p.time_ns for p in smooth[1]]


def test_a_copy_goes_on_as_the_stage_would_have() -> None:
    given = items(signal(), steps())
    whole = plain()
    first = stage()
    events = [e for item in given[:80] for e in first.process(item)]
    second = copy.deepcopy(first)
    events += run(second, given[80:])
    assert repr(points(events)) == repr(points(whole))


@pytest.mark.parametrize(
    ("kind", "turn", "part"), [("backward", np.pi, 0.7), ("left", np.pi / 2, 0.5)]
)
def test_steps_of_other_types_go_another_way_and_less_far(
    kind: str, turn: float, part: float
) -> None:
    found = points(run(stage(), items(signal(corners_s=()), steps(kind=kind))))
    far = part * LENGTH_M * len(steps())
    assert found[-1].x_m == pytest.approx(far * math.cos(turn), abs=0.3)
    assert found[-1].y_m == pytest.approx(far * math.sin(turn), abs=0.3)


def test_a_step_too_soon_after_another_is_a_candidate_but_not_taken() -> None:
    given = steps()
    extra = replace(given[10], time_ns=given[10].time_ns + NS_PER_S // 10)
    events = run(stage(), items(signal(), sorted([*given, extra], key=lambda s: s.time_ns)))
    blocks = [e for e in events if isinstance(e, CandidateBlock)]
    rejected = [int(b.time_ns[0]) for b in blocks if not b.accepted[0]]
    assert rejected == [extra.time_ns]
    assert len(points(events)) == len(given) + 1
    assert blocks[0].spec.gates[0].name == "cadence"


def waypoint(time_s: float, x: float, y: float) -> Label:
    return Label(round(time_s * NS_PER_S), "waypoint", x_m=x, y_m=y)


LABELS = (waypoint(1.4, 100.0, 50.0), waypoint(10.0, 100.0, 62.0), waypoint(25.0, 60.0, 60.0))


def test_waypoints_count_only_where_they_are_asked_for() -> None:
    given = run(stage(P, LABELS), items(signal(), steps()))
    assert repr(points(plain())) == repr(points(given))


def test_two_waypoints_give_place_and_direction_without_a_compass() -> None:
    p = replace(P, updates="first-two", azimuth="gyroscope")
    found = points(run(stage(p, LABELS), items(signal(), steps())), "track.smoothed")
    assert (found[0].x_m, found[0].y_m) == (pytest.approx(100, abs=1), pytest.approx(50, abs=1))
    near = min(found, key=lambda q: abs(q.time_ns - 10 * NS_PER_S))
    assert (near.x_m, near.y_m) == (pytest.approx(100, abs=1), pytest.approx(62, abs=1))
    # where east was north the walk turns to the west, and the third waypoint is not looked at
    assert found[-1].x_m == pytest.approx(100 - LENGTH_M * 26, abs=2.5)


def test_all_waypoints_pull_the_track_and_tell_how_surprising_they_were() -> None:
    labels = (LABELS[0], waypoint(10.0, 112.0, 50.0), waypoint(25.0, 122.0, 66.0))
    p = replace(P, updates="waypoints")
    found = points(run(stage(p, labels), items(signal(), steps())))
    assert sum(math.isfinite(q.nis) for q in found) == 2
    near = min(found, key=lambda q: abs(q.time_ns - 25 * NS_PER_S))
    assert math.hypot(near.x_m - 122, near.y_m - 66) < 2


def test_satellite_fixes_are_taken_in_where_there_are_some() -> None:
    metres = LENGTH_M / STEP_S * 1.1 * np.clip(np.arange(30.0) - 1.5, 0, None)
    degrees = np.stack([46.5 + 0 * metres, 6.6 + metres / 76_770], axis=1)
    fixes = [SignalBlock(PLACE, 0, k, degrees[k : k + 1]) for k in range(30)]
    blocks = sorted([*signal(corners_s=()), *fixes], key=lambda b: b.last_ns)
    found = points(run(stage(), items(blocks, steps())))
    alone = points(run(stage(), items(signal(corners_s=()), steps())))
    assert any(math.isfinite(q.nis) for q in found)
    assert abs(found[-1].x_m - metres[-1]) < abs(alone[-1].x_m - metres[-1])


def lost(
    start_s: float, stop_s: float, silent_s: float = 0.0, *, parameters: ReckoningParameters = P
) -> list[TrackPoint]:
    """Track of a walk to the north of which a time is lost; its last step comes before by so much.

    Before, it goes to the east, so that the gyroscope's frame is turned by a corner after it.
    """
    before, after = signal(start_s, (8.0,)), signal(40.0, (8.0,))
    moved = [b for b in after if b.start_ns >= stop_s * NS_PER_S]
    gap = Gap("/acc", round(start_s * NS_PER_S), round(stop_s * NS_PER_S), "missing", 200)
    early = [s for s in steps(40.0) if s.time_ns < (start_s - silent_s) * NS_PER_S]
    late = [s for s in steps(28.0) if s.time_ns > stop_s * NS_PER_S]
    return points(run(stage(parameters), [*items(before, early), gap, *items(moved, late)[1:]]))


def at_gap(found: Sequence[TrackPoint], stop_s: float) -> tuple[TrackPoint, TrackPoint]:
    """Return the last point before a gap, and the first after it."""
    after = next(k for k, p in enumerate(found) if p.time_ns >= stop_s * NS_PER_S)
    return found[after - 1], found[after]


def test_who_walks_before_and_after_a_gap_went_on_as_before_less_surely() -> None:
    found = lost(14.0, 17.0)
    assert {p.track for p in found} == {1}
    before, after = at_gap(found, 17.0)
    gone_s = (after.time_ns - before.time_ns) / NS_PER_S
    assert after.y_m - before.y_m == pytest.approx(LENGTH_M / STEP_S * gone_s, rel=0.1)
    assert after.x_m == pytest.approx(before.x_m, abs=0.2)
    assert after.covariance[0] > before.covariance[0] + 1.0
    whole = points(run(stage(), items(signal(40.0, (8.0,)), steps(28.0))))
    assert found[-1].x_m == pytest.approx(whole[-1].x_m, abs=1.5)
    assert found[-1].y_m == pytest.approx(whole[-1].y_m, abs=1.5)


@pytest.mark.parametrize("samples", [1, 7, 400])
def test_a_gap_counts_the_same_whatever_the_blocks(samples: int) -> None:
    before, after = signal(14.0, (8.0,)), signal(30.0, (8.0,))
    moved = [b for b in after if b.start_ns >= 17 * NS_PER_S]
    gaps = [Gap(topic, 14 * NS_PER_S, 17 * NS_PER_S, "missing", 150) for topic in ("/gyro", "/acc")]
    early = [s for s in steps(28.0) if s.time_ns < 14 * NS_PER_S]
    late = [s for s in steps(28.0) if s.time_ns > 17 * NS_PER_S]

    def cut(blocks: Sequence[SignalBlock]) -> list[SignalBlock]:
        parts = [
            b.slice(k, min(k + samples, len(b))) for b in blocks for k in range(0, len(b), samples)
        ]
        return sorted(parts, key=lambda b: (b.start_ns, b.topic))

    def tracked(first: Sequence[SignalBlock], second: Sequence[SignalBlock]) -> list[TrackPoint]:
        given = [*items(first, early), *gaps, *items(second, late)[1:]]
        return points(run(stage(), given))

    whole, parted = tracked(before, moved), tracked(cut(before), cut(moved))
    assert len(whole) == len(parted) == len(steps(28.0)) - 5
    for one, other in zip(whole, parted, strict=True):
        assert (one.time_ns, one.x_m, one.y_m) == pytest.approx(
            (other.time_ns, other.x_m, other.y_m), abs=1e-9
        )


def test_a_gyroscope_alone_keeps_its_direction_over_a_gap() -> None:
    found = lost(14.0, 16.0, parameters=replace(P, azimuth="gyroscope"))
    before, after = at_gap(found, 16.0)
    # its north is where the phone pointed first
    assert before.x_m < -LENGTH_M / STEP_S * 4
    assert after.x_m < before.x_m - 2.0
    assert found[-1].x_m < after.x_m - 10.0
    assert found[-1].y_m == pytest.approx(after.y_m, abs=0.2)


def test_who_stood_before_a_gap_is_not_taken_to_have_walked_on() -> None:
    before, after = at_gap(lost(20.0, 21.0, silent_s=8.0), 21.0)
    assert (after.x_m, after.y_m) == pytest.approx((before.x_m, before.y_m), abs=0.05)
    walking = at_gap(lost(12.0, 21.0), 21.0)
    spread = [
        sum(now.covariance[::2]) - sum(then.covariance[::2])
        for then, now in ((before, after), walking)
    ]
    assert spread[0] < 0.2 * spread[1]


def test_places_within_a_gap_are_taken_in() -> None:
    labels = [
        Label(time_ns=0, kind="waypoint", x_m=0.0, y_m=0.0),
        Label(time_ns=18 * NS_PER_S, kind="waypoint", x_m=20.0, y_m=-3.0),
    ]
    made = stage(replace(P, updates="waypoints"), labels)
    before, after = signal(14.0, ()), signal(30.0, ())
    moved = [b for b in after if b.start_ns >= 24 * NS_PER_S]
    gap = Gap("/acc", 14 * NS_PER_S, 24 * NS_PER_S, "missing", 500)
    early = [s for s in steps() if s.time_ns < 14 * NS_PER_S]
    late = [s for s in steps() if s.time_ns > 24 * NS_PER_S]
    found = points(run(made, [*items(before, early), gap, *items(moved, late)[1:]]))
    (met,) = [p for p in found if p.time_ns == 18 * NS_PER_S]
    assert (met.x_m, met.y_m) == pytest.approx((20.0, -3.0), abs=0.6)


def test_steps_without_a_gyroscope_lead_nowhere_and_that_is_said() -> None:
    blocks = [b for b in signal() if b.topic == "/acc"]
    events = run(stage(), items(blocks, steps()))
    assert not points(events)
    (note,) = [e for e in events if isinstance(e, Note)]
    assert "expected a gyroscope" in note.text


def test_the_compass_alone_follows_every_disturbance() -> None:
    blocks = signal(corners_s=())
    disturbed = [
        replace(b, samples=b.samples + np.array([0, 3e-5, 0]))
        if b.topic == "/mag" and 10 <= b.start_ns / NS_PER_S < 20
        else b
        for b in blocks
    ]
    off = {}
    for azimuth in ("fused", "compass"):
        found = points(run(stage(replace(P, azimuth=azimuth)), items(disturbed, steps())))
        off[azimuth] = abs(found[-1].y_m)
    assert off["fused"] < 0.25 * off["compass"]


def test_a_pipeline_without_steps_is_refused() -> None:
    text = b'name = "x"\napplication = "walker"\n[[stage]]\nuse = "reckoning"\n'
    with pytest.raises(PipelineError, match="expected a stage that gives steps before it"):
        build_pipeline(parse_pipeline(text, "x.toml"))


def test_steps_on_a_stair_are_as_long_as_its_treads() -> None:
    """Ten seconds on the level, ten up a stair with risers of 0.17 m, ten on the level."""
    baro = Stream("/baro", (Channel("pressure", "pressure", "Pa"),), 10.0, "phone")
    seconds = np.arange(300) / 10
    height_m = 0.17 / STEP_S * np.clip(seconds - 10, 0, 10)
    pressure = 97_600.0 * np.exp(-height_m / 8434.5)
    blocks = signal(corners_s=())
    with_height = [
        item
        for k, block in enumerate(blocks)
        for item in (
            [SignalBlock(baro, 0, 5 * (k // 3), pressure[5 * (k // 3) :][:5, None]), block]
            if k % 3 == 0
            else [block]
        )
    ]
    flat, stair = (
        {round(p.time_ns / NS_PER_S, 1): p.x_m for p in points(run(stage(), items(x, steps())))}
        for x in (blocks, with_height)
    )
    assert flat[18.0] - flat[12.0] == pytest.approx(12 * LENGTH_M, abs=0.2)
    assert stair[18.0] - stair[12.0] == pytest.approx(12 * 0.29, abs=0.1)
    assert stair[27.0] - stair[23.0] == pytest.approx(8 * LENGTH_M, abs=0.2)


def test_a_fix_counts_as_much_as_it_says() -> None:
    exact = Channel("accuracy", "horizontal_accuracy", "m")
    told = replace(PLACE, channels=(*PLACE.channels, exact))
    ends = []
    for accuracy_m in (1.0, 100.0):
        aside = np.stack([np.full(30, 1e-4), np.zeros(30), np.full(30, accuracy_m)], axis=1)
        aside[:5, 0] = 0.0  # later ones are 11 m north of where the walk begins
        fixes = [SignalBlock(told, 0, k, aside[k : k + 1]) for k in range(30)]
        blocks = sorted([*signal(corners_s=()), *fixes], key=lambda b: b.last_ns)
        ends.append(points(run(stage(), items(blocks, steps())))[-1].y_m)
    assert ends[0] > 6
    assert abs(ends[1]) < 5


def test_a_field_that_scatters_leaves_directions_open() -> None:
    """Iron that turns with the phone: each straight way has a field of its own direction."""
    blocks, iron = signal(corners_s=(15.0,)), np.array([6e-5, 0.0, 0.0])
    with_iron = [
        replace(b, samples=b.samples + iron) if b.topic == FIELD.topic else b for b in blocks
    ]
    events = [run(stage(), items(x, steps())) for x in (blocks, with_iron)]
    last = [[e for e in x if isinstance(e, Heading)][-1].sigma_rad for x in events]
    ends = [points(x)[-1] for x in events]
    spreads = [math.sqrt(p.covariance[0] + p.covariance[2]) for p in ends]
    assert last[1] > 2 * last[0]
    assert spreads[1] > 1.5 * spreads[0]
    (note,) = [e.text for e in events[1] if isinstance(e, Note) and "scatters" in e.text]
    assert "all directions together may be off by 10 degrees" not in note


def with_iron(blocks: Sequence[SignalBlock], iron: Sequence[float]) -> list[SignalBlock]:
    """Blocks of a phone that carries iron, the field of which is in its axes [T]."""
    return [
        replace(b, samples=b.samples + np.array(iron)) if b.topic == FIELD.topic else b
        for b in blocks
    ]


@pytest.mark.parametrize("parameters", [P, replace(P, smooth=False), replace(P, smooth_s=20.0)])
def test_iron_on_the_sensor_is_told_and_taken_away(parameters: ReckoningParameters) -> None:
    """Where three ways have shown it; from the end on, the whole piece is gone again."""
    blocks, found = signal(60.0, (15.0, 30.0, 45.0)), steps(60.0)
    iron = (2.5e-5, -2e-5, 1e-5)
    plain, laden = (
        run(stage(parameters), items(x, found)) for x in (blocks, with_iron(blocks, iron))
    )
    (news,) = [e for e in laden if isinstance(e, Note) and "turn with the sensor" in e.text][:-1]
    assert 30 < news.time_ns / NS_PER_S < 38
    assert news.text.startswith("25, -20, 0 uT")  # a level phone tells nothing of the vertical
    assert not [e for e in plain if isinstance(e, Note) and "iron" in e.text]
    kind = "track.smoothed" if parameters.smooth else "track"
    ways = [
        [(p.x_m, p.y_m) for p in events if isinstance(p, TrackPoint) and p.stage == kind]
        for events in (plain, laden)
    ]
    last = [np.subtract(way[-1], way[-15]) for way in ways]
    np.testing.assert_allclose(*last, atol=0.3)
    if parameters is P:
        np.testing.assert_allclose(*ways, atol=0.5)
