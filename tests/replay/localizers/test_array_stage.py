"""The stage that looks at the waveforms around steps: the same windows whatever the blocks."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from replay_blocks import START_NS, stream_of

from groundtrace.errors import PipelineError
from groundtrace.localizers.array_method import ArrayMethod, ArrayParameters, Window, takes_steps
from groundtrace.pipeline.buffers import SignalBuffer
from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import PipelineConfig
from groundtrace.pipeline.gates import Candidates
from groundtrace.pipeline.parameters import StageConfig
from groundtrace.pipeline.stage import StageRunner
from groundtrace_codecs.events import (
    Bearing,
    CandidateBlock,
    Gap,
    Note,
    Pick,
    Quantity,
    StageSpec,
    StepEvent,
)
from groundtrace_codecs.geometry import Geometry, Sensor
from groundtrace_codecs.signals import SignalBlock

if TYPE_CHECKING:
    from collections.abc import Sequence

MS = 1_000_000
STREAM = stream_of(3)  # 1 kHz: a sample every ms
NAMES = ("G1", "G2", "G3")
STATED = [
    StageSpec("steps", "coincidence", "/s", ("all",), (), (), (), "step"),
    StageSpec("picks", "toa-cv", "/s", NAMES, (), (), (), "pick"),
]


#: What the last witness was shown.
WINDOWS: list[Window] = []


class Witness(ArrayMethod):
    """Keeps the windows it is shown; one candidate a channel, at its pick."""

    Parameters = ArrayParameters
    takes = takes_steps(frozenset({"seismic"}))
    needs = "channels"
    gives = (Pick,)
    columns = (Quantity("first", "1"), Quantity("last", "1"))
    gates = ()

    def __init__(self, parameters: ArrayParameters) -> None:  # noqa: ARG002
        WINDOWS.clear()

    def prepare(self, stream: Any, geometry: Any) -> tuple[str, ...]:  # noqa: ARG002
        return tuple(c.name for c in stream.channels)

    def examine(self, window: Window) -> Candidates:
        WINDOWS.append(window)
        heard = np.flatnonzero(np.isfinite(window.arrivals_s))
        times = window.start_ns + np.rint(window.arrivals_s[heard] * 1e9).astype(np.int64)
        ends = window.values[[0, -1]].T[heard]
        return Candidates(times, heard.astype(np.int32), ends.astype(np.float32))


class Deaf(Witness):
    """Wants what no stream has."""

    needs = "stations of three axes in the geometry"
    gives = (Bearing,)

    def prepare(self, stream: Any, geometry: Any) -> tuple[str, ...]:  # noqa: ARG002
        return ()


def stage(kind: type[Any] = Witness, geometry: Geometry | None = None) -> StageRunner:
    parameters = ArrayParameters(before_s=0.02, after_s=0.03)
    sources = dict(zip(kind.takes, ((), ("picks",), ("steps",)), strict=True))
    config = StageConfig("witness", "arrivals")
    return StageRunner(config, kind, parameters, sources, geometry, window_s=0.05)


def ramp(first: int, count: int, anchor_ns: int = START_NS) -> SignalBlock:
    """Samples that say which they are: 3 k, 3 k + 1, 3 k + 2 in the three channels."""
    samples = 3.0 * np.arange(first, first + count)[:, None] + np.arange(3)
    return SignalBlock(STREAM, anchor_ns, first, samples)


def pick(channel: int, at_ms: float) -> Pick:
    return Pick(START_NS + round(at_ms * MS), f"G{channel}", "/s", "picks", 1e-4, 9.0)


def step(at_ms: float) -> StepEvent:
    return StepEvent(START_NS + round(at_ms * MS), "step", "", "/s", "steps", 3.0, 3)


def fed(runner: StageRunner, items: Sequence[Any]) -> list[Any]:
    """What comes of blocks, which are remembered first, and events."""
    events = []
    for item in items:
        if isinstance(item, SignalBlock):
            runner.buffer(item)
        events += list(runner.process(item))
    return events


ARRIVALS = [pick(2, 500.0), pick(1, 501.5), pick(3, 540.0)]


def test_a_step_is_shown_with_its_waveforms_and_first_arrivals() -> None:
    runner = stage()
    fed(runner, [*STATED, ramp(0, 2000), *STATED, *ARRIVALS, pick(2, 503.0), step(500.0)])
    (window,) = WINDOWS
    assert window.step_ns - window.start_ns == 20 * MS
    assert window.values[:, 0].tolist() == (3.0 * np.arange(480, 530)).tolist()
    assert window.arrivals_s == pytest.approx([0.0215, 0.020, 0.060])


def test_its_picks_come_before_the_step_reaches_the_stages_behind() -> None:
    items = [ramp(0, 2000), *STATED, *ARRIVALS, step(500.0)]
    spec, block, *picks = fed(stage(), items)
    assert isinstance(spec, StageSpec)
    assert (spec.stage, spec.channels, spec.emits) == ("arrivals", NAMES, "pick")
    assert isinstance(block, CandidateBlock)
    assert [(p.channel, p.stage, p.time_ns) for p in picks] == [
        (p.channel, "arrivals", p.time_ns) for p in sorted(ARRIVALS, key=lambda p: p.channel)
    ]


@pytest.mark.parametrize("size", [1, 7, 200, 2000, 200_000])
@pytest.mark.parametrize("later_s", [0.1, 2.9, 170.0])
def test_a_step_announced_late_is_shown_the_same_window_whatever_the_blocks(
    size: int, later_s: float
) -> None:
    runner, at = stage(), 600 + round(later_s * 1000)
    coming = [(540 + 300, [*ARRIVALS]), (at, [step(500.0)])]  # picks come 0.3 s late
    total, events, done = max(at, 1000) + size, [], 0
    size = max(size, total // 2000)  # enough blocks of a sample near the step
    for first in range(0, total, size):
        block = ramp(first, size)
        runner.buffer(block)
        if not first:
            events += fed(runner, STATED)
        while done < 2 and coming[done][0] <= first + size:
            for event in coming[done][1]:
                events += list(runner.process(event))
            done += 1
    (window,) = WINDOWS
    assert window.values[:, 0].tolist() == (3.0 * np.arange(480, 530)).tolist()
    assert window.arrivals_s == pytest.approx([0.0215, 0.020, 0.060])


def test_what_no_step_can_ask_for_is_forgotten() -> None:
    recall = SignalBuffer(STREAM, 20 * MS, 30 * MS, 50 * MS, np.zeros(3))
    for k in range(100):
        recall.update(ramp(100 * k, 100))
    assert sum(len(b) for b in recall._blocks) <= 3100


def test_samples_that_were_never_recorded_hold_the_nearest() -> None:
    runner = stage()
    lost = Gap("/s", START_NS + 495 * MS, START_NS + 505 * MS, "missing", 10)
    fed(runner, [ramp(0, 495), *STATED, lost, ramp(505, 500), *ARRIVALS, step(500.0)])
    column = WINDOWS[0].values[:, 0]
    assert column[:15].tolist() == (3.0 * np.arange(480, 495)).tolist()
    assert set(column[15:25].tolist()) == {3.0 * 494, 3.0 * 505}
    assert column[25:].tolist() == (3.0 * np.arange(505, 530)).tolist()


def test_a_window_over_the_end_of_the_recording_holds_the_nearest() -> None:
    runner = stage()
    fed(runner, [ramp(0, 80), *STATED, pick(1, 70.0), step(70.0)])
    column = WINDOWS[0].values[:, 0]
    assert column.tolist() == (3.0 * np.clip(np.arange(50, 100), 0, 79)).tolist()


@pytest.mark.parametrize(("at_ms", "count"), [(59.0, 0), (61.0, 1)])
@pytest.mark.parametrize("before_ms", [0, 1000])
def test_nothing_is_told_of_a_step_whose_begin_may_be_missing(
    at_ms: float, count: int, before_ms: int
) -> None:
    runner, at_ms = stage(), at_ms + before_ms
    begun = ramp(0, 200, START_NS + before_ms * MS)
    earlier = [ramp(0, 900)] if before_ms else []
    made = fed(runner, [*earlier, begun, *STATED, pick(1, at_ms), step(at_ms)])
    assert len(WINDOWS) == count
    notes = [e.text for e in made if isinstance(e, Note)]
    assert notes == [
        "/s: there is less than 60 ms of signal before this step: what came first may be missing, "
        "so that arrivals tells nothing of it"
    ] * (1 - count)


def test_after_a_clock_step_nothing_from_before_is_shown() -> None:
    runner = stage()
    back = Gap("/s", START_NS + 1000 * MS, START_NS, "clock step", 0)
    again = ramp(0, 1000)
    again = SignalBlock(STREAM, START_NS, 0, again.samples + 1e6)
    items = [ramp(0, 1000), *STATED, *ARRIVALS, step(500.0), back, again, pick(1, 700), step(700)]
    fed(runner, items)
    _, after = WINDOWS
    assert (after.values > 1e6).all()
    assert np.isfinite(after.arrivals_s).tolist() == [True, False, False]


def test_a_copy_made_between_pick_and_step_goes_on_for_itself() -> None:
    one = stage()
    fed(one, [ramp(0, 2000), *STATED, *ARRIVALS[:2]])
    other = copy.deepcopy(one)
    fed(one, [pick(2, 900.0), step(900.0)])  # what the first does later is not seen by the second
    events = fed(other, [ARRIVALS[2], step(500.0)])
    assert [type(e).__name__ for e in events] == ["CandidateBlock", "Pick", "Pick", "Pick"]


def test_other_topics_and_stages_are_left_alone() -> None:
    runner = stage()
    foreign = Pick(START_NS + 500 * MS, "G1", "/t", "picks", 1e-4, 9.0)
    other = [replace(spec, topic="/t") for spec in STATED]
    assert fed(runner, [*other, ramp(0, 1000), foreign, step(500.0)]) == []


def test_a_window_longer_than_a_step_waits_is_refused() -> None:
    stages = (
        StageConfig("toa-cv"),
        StageConfig("coincidence"),
        StageConfig("gcc-phat", parameters={"after_s": 0.2}),
    )
    with pytest.raises(PipelineError, match=r"gcc-phat.after_s: expected at most the 0.05 s"):
        build_pipeline(PipelineConfig("p", stage=stages))
    with pytest.raises(PipelineError, match="gcc-phat: expected a stage that gives picks"):
        build_pipeline(PipelineConfig("p", stage=stages[2:]))


def test_channels_whose_clocks_are_known_to_be_off_are_moved_to_the_common_one() -> None:
    ahead = {"G1": 0.004, "G2": -0.003}
    sensors = tuple(Sensor(n, n, 0.0, 0.0, clock_offset_s=s) for n, s in ahead.items())
    runner = stage(geometry=Geometry(sensors))
    # by the common clock: 498 ms, 500 ms, 510 ms
    arrivals = [pick(2, 497.0), pick(1, 502.0), pick(3, 510.0)]
    fed(runner, [ramp(0, 2000), *STATED, ramp(2000, 100), *arrivals, step(497.0)])
    (window,) = WINDOWS
    assert window.start_ns == START_NS + 478 * MS
    assert window.arrivals_s == pytest.approx([0.020, 0.022, 0.032])
    assert window.values[0].tolist() == [3 * 482 + 0, 3 * (478 - 3) + 1, 3 * 478 + 2]
    assert window.values.shape == (50, 3)


def test_what_a_method_lacks_is_said_once_with_the_first_step() -> None:
    runner = stage(Deaf)
    events = fed(runner, [ramp(0, 2000), *STATED, *ARRIVALS, step(500.0), step(900.0)])
    (note,) = events
    assert isinstance(note, Note)
    assert note.text == (
        "/s: no bearings: expected stations of three axes in the geometry, found none"
    )
    assert (note.level, note.source, note.time_ns) == ("WARN", "arrivals", START_NS + 500 * MS)
