"""Sweeps: exact, whatever is swept; each recording left out; ranked as counted."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from groundtrace.errors import PipelineError, RecordingError
from groundtrace.evaluation.matching import match_steps
from groundtrace.explain.redecide import (
    Axis,
    Counts,
    OfflineDecider,
    StepChain,
    make_grid,
    parse_axis,
)
from groundtrace.explain.sweep import (
    Subject,
    count,
    f1_of,
    measure_evidence,
    rank,
    reproduced,
    resolved,
    with_values,
)
from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import PipelineConfig, load_pipeline
from groundtrace.pipeline.engine import EventList, replay
from groundtrace.pipeline.results import stage_evidence
from groundtrace.pipeline.source import Source
from groundtrace_codecs.events import StepEvent
from groundtrace_codecs.recording import Recording
from groundtrace_recordings import path_of

if TYPE_CHECKING:
    from groundtrace.pipeline.results import Evidence
    from groundtrace_codecs.signals import SignalBlock

WAIST_GATES = (
    "steps.height=0.1:2.5:9",
    "steps.swing=0.1:4:9",
    "steps.activity=0.05:1:5",
    "steps.refractory_s=0:0.9:9",
)
ROOM_CHAIN = (
    "picks.ratio=5:12:5",
    "picks.refractory_s=0:0.5:5",
    "steps.min_channels=1:9:9",
    "steps.window_s=0.05:0.1:5",  # not less than times-amplitudes.after_s
    "steps.refractory_s=0:0.9:5",
)


@dataclass(frozen=True)
class Walk:
    """A bundled recording, read once, and what its pipeline measured of it."""

    items: tuple[SignalBlock, ...]
    evidence: Evidence

    @property
    def config(self) -> PipelineConfig:
        return self.evidence.config

    def replayed(self, axes: tuple[Axis, ...], values: tuple[object, ...]) -> np.ndarray:
        """Times of the steps of a fresh replay."""
        sink = EventList()
        replay(self.items, build_pipeline(with_values(self.config, axes, values)), [sink])
        times = [e.time_ns for e in sink.events if isinstance(e, StepEvent) and e.stage == "steps"]
        return np.array(sorted(times), np.int64)


def walk_of(name: str, pipeline: str, topic: str) -> Walk:
    with Recording.open(path_of(name)) as recording:
        items = tuple(Source(recording, topics=[topic], block_s=60.0))
    return Walk(items, measure_evidence(path_of(name), load_pipeline(pipeline)))


@pytest.fixture(scope="module")
def waist() -> Walk:
    return walk_of("waist-walk.mcap", "waist-peaks", "/imu/waist")


@pytest.fixture(scope="module")
def room() -> Walk:
    return walk_of("room-walk.mcap", "room-footsteps", "/seismic")


def axes_of(config: PipelineConfig, texts: tuple[str, ...]) -> tuple[Axis, ...]:
    return tuple(parse_axis(text, config) for text in texts)


def assert_every_setting_decides_as_a_replay(walk: Walk, texts: tuple[str, ...], n: int) -> None:
    grid = make_grid(axes_of(walk.config, texts), random=n, seed=5)
    chain = StepChain(walk.evidence, grid.axes)
    found = set()
    for row in chain.order(grid.rows):
        swept = np.sort(chain.step_times(grid.rows[row]))
        expected = walk.replayed(grid.axes, grid.rows[row])
        assert np.array_equal(swept, expected), grid.setting(row)
        found.add(len(swept))
    assert len(found) > 3


def test_two_hundred_random_settings_decide_as_fresh_replays_do(waist: Walk) -> None:
    assert_every_setting_decides_as_a_replay(waist, WAIST_GATES, 200)


def test_thirty_random_settings_through_an_associator_decide_as_fresh_replays_do(
    room: Walk,
) -> None:
    assert_every_setting_decides_as_a_replay(room, ROOM_CHAIN, 30)


def test_the_order_of_settings_changes_no_decision(waist: Walk) -> None:
    grid = make_grid(axes_of(waist.config, WAIST_GATES), random=60)
    chain = StepChain(waist.evidence, grid.axes)
    sorted_times = {row: chain.step_times(grid.rows[row]) for row in chain.order(grid.rows)}
    for row in range(len(grid)):
        fresh = StepChain(waist.evidence, grid.axes).step_times(grid.rows[row])
        assert np.array_equal(chain.step_times(grid.rows[row]), fresh)
        assert np.array_equal(sorted_times[row], fresh)


def test_counts_are_those_of_the_score(waist: Walk) -> None:
    grid = make_grid(axes_of(waist.config, WAIST_GATES), random=40, seed=1)
    counted = count([Subject(waist.evidence, ())], grid, 0.08)
    redecider = OfflineDecider(waist.evidence)
    for row, values in enumerate(grid.rows):
        keys = ((axis.stage, axis.parameter) for axis in grid.axes)
        matching = redecider.matching(dict(zip(keys, values, strict=True)), 0.08)
        c = Counts.of(matching)
        assert counted.counts[0, row].tolist() == [c.tp, c.fp, c.fn]


def test_a_parameter_of_the_signal_path_is_measured_again_as_a_replay_does(waist: Walk) -> None:
    axes = axes_of(waist.config, ("steps.cutoff_hz=2,3,4", "steps.height=0.3,0.9"))
    assert [axis.remeasure for axis in axes] == [True, False]
    grid = make_grid(axes)
    done: list[int] = []
    subject = Subject(waist.evidence, (path_of("waist-walk.mcap"),))
    counted = count([subject], grid, jobs=1, done=lambda: done.append(1))
    assert len(done) == counted.rate.measurements == 2  # 3 Hz is what was stored
    e = waist.evidence
    for row, values in enumerate(grid.rows):
        times = waist.replayed(axes, values)
        c = Counts.of(match_steps(e.labels, times, e.start_ns, e.end_ns))
        assert counted.counts[0, row].tolist() == [c.tp, c.fp, c.fn], values


def test_without_the_recording_the_signal_path_is_not_swept(waist: Walk) -> None:
    grid = make_grid(axes_of(waist.config, ("steps.cutoff_hz=2,4",)))
    with pytest.raises(RecordingError, match="expected the recording beside its results"):
        count([Subject(waist.evidence, (Path("nowhere.mcap"),))], grid)


def test_a_setting_below_the_stored_floor_is_refused(room: Walk) -> None:
    grid = make_grid(axes_of(room.config, ("picks.ratio=0.5:6:3",)))
    with pytest.raises(PipelineError, match="expected at least the stored floor"):
        count([Subject(room.evidence, ())], grid)


def test_a_pipeline_without_steps_is_refused(room: Walk) -> None:
    config = replace(room.config, stage=room.config.stage[:1])
    with pytest.raises(RecordingError, match="expected a stage that finds steps"):
        StepChain(replace(room.evidence, config=config), ())


def test_what_was_stored_is_reproduced(waist: Walk, room: Walk) -> None:
    assert reproduced(Subject(waist.evidence, ()))
    assert reproduced(Subject(room.evidence, ()))
    first = waist.evidence.stages[0]
    wrong = replace(first, accepted=~first.accepted)
    assert not reproduced(Subject(replace(waist.evidence, stages=(wrong,)), ()))


def test_each_recording_is_left_out_in_turn(waist: Walk) -> None:
    third = (waist.evidence.end_ns - waist.evidence.start_ns) // 3
    cut = [waist.evidence.start_ns + k * third for k in range(4)]
    subjects = [
        Subject(
            replace(
                waist.evidence,
                name=f"part{k}.mcap",
                labels=tuple(
                    x
                    for x in waist.evidence.labels
                    if x.kind == "step" and cut[k] <= x.time_ns < cut[k + 1]
                ),
            ),
            (),
        )
        for k in range(3)
    ]
    grid = make_grid(axes_of(waist.config, ("steps.height=0.5:3:26", "steps.swing=1:5:9")))
    counted = count(subjects, grid)
    ranking = rank(counted, top=3)
    assert ranking.left_out is not None
    for k, part in enumerate(ranking.left_out.recordings):
        others = f1_of(np.delete(counted.counts, k, axis=0).sum(axis=0))
        row = grid.rows.index(tuple(part.settings.values()))
        assert others[row] == others.max()
        assert [part.tp, part.fp, part.fn] == counted.counts[k, row].tolist()
        assert part.f1 <= part.in_sample_f1 == f1_of(counted.counts[k]).max()
    assert ranking.left_out.mean_f1 <= ranking.left_out.mean_in_sample_f1
    assert ranking.truth == counted.counts[:, 0, [0, 2]].sum()


def test_the_ranking_counts_as_the_whole_does(waist: Walk) -> None:
    grid = make_grid(axes_of(waist.config, WAIST_GATES[:2]))
    counted = count([Subject(waist.evidence, ())], grid)
    ranking = rank(counted, top=4)
    f1 = f1_of(counted.counts[0])
    assert [r.f1 for r in ranking.top] == sorted(set(f1.tolist()))[::-1][:4]
    for r in ranking.top:
        assert r.same == (f1 == r.f1).sum()
        row = grid.rows.index(tuple(r.settings.values()))
        assert [r.tp, r.fp, r.fn] == counted.counts[0, row].tolist()
    assert ranking.best == ranking.top[0]
    assert ranking.left_out is None
    assert ranking.notes == ()
    standing = match_steps(
        waist.evidence.labels,
        waist.replayed((), ()),
        waist.evidence.start_ns,
        waist.evidence.end_ns,
    )
    assert (ranking.now.tp, ranking.now.fp) == (Counts.of(standing).tp, Counts.of(standing).fp)


def test_a_resolved_pipeline_resolves_to_itself() -> None:
    config = resolved(load_pipeline("room-footsteps"))
    assert resolved(config) == config
    assert with_values(config, (), ()) == config


def test_a_pipeline_that_takes_in_waypoints_is_measured_again_with_them() -> None:
    path, config = path_of("waist-walk.mcap"), resolved(load_pipeline("pedestrian-waypoints"))
    sink = EventList()
    with Recording.open(path) as recording:
        chain = build_pipeline(config, recording.geometry, recording.labels)
        replay(Source(recording), chain, [sink])
    stored = stage_evidence(sink.events, ["steps", "track"])
    for one, other in zip(measure_evidence(path, config).stages, stored, strict=True):
        assert one.spec == other.spec
        assert np.array_equal(one.candidates.value, other.candidates.value, equal_nan=True)
