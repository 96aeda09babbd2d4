"""Sweeps: exact, whatever is swept; the middle of plateaus; bootstrap; each one left out."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from groundtrace.engine import replay
from groundtrace.errors import PipelineError, RecordingError
from groundtrace.explain.bootstrap import Verdicts, bootstrap
from groundtrace.explain.chain import StepChain
from groundtrace.explain.evidence import Evidence
from groundtrace.explain.grid import Axis, Grid, make_grid, parse_axis
from groundtrace.explain.measuring import EventList, measure_evidence, resolved, with_values
from groundtrace.explain.plateau import middle, pareto_front
from groundtrace.explain.ranking import rank
from groundtrace.explain.redecide import Counts, Redecider
from groundtrace.explain.sweep import Subject, count, f1_of, reproduced
from groundtrace.pipeline import PipelineConfig, build_pipeline, load_pipeline
from groundtrace.score import match_steps
from groundtrace.source import Source
from groundtrace_codecs.events import StepEvent
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S, SignalBlock
from groundtrace_recordings import path_of

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
    "steps.window_s=0.01:0.1:5",
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
    return walk_of("waist-walk.mcap", "waist-steps", "/imu/waist")


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
    redecider = Redecider(waist.evidence)
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
    counted = count([subject], grid, jobs=2, done=lambda: done.append(1))
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


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("steps.height=0.2:1:5", (0.2, 0.4, 0.6, 0.8, 1.0)),
        ("steps.height=0.2,1,0.7", (0.2, 1.0, 0.7)),
        ("steps.height=1", (1.0,)),
    ],
)
def test_a_range_has_both_ends_and_a_list_its_order(waist: Walk, text, values) -> None:
    axis = parse_axis(text, waist.config)
    assert axis.values == values
    assert all(isinstance(v, float) for v in axis.values)


def test_a_whole_parameter_keeps_whole_values_each_once(room: Walk) -> None:
    axis = parse_axis("steps.min_channels=1:4:7", room.config)
    assert axis.values == (1, 2, 3, 4)
    assert {type(v) for v in make_grid([axis], random=50).rows[0]} == {int}
    assert not parse_axis("steps.window_s=0.01:0.1:3", room.config).remeasure


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("height=1:2:3", "expected stage.param=FROM:TO:COUNT or"),
        ("steps.height", "expected stage.param=FROM:TO:COUNT or"),
        ("steps.height=", "expected stage.param=FROM:TO:COUNT or"),
        ("stairs.height=1:2:3", "expected a stage of steps, found 'stairs'"),
        ("steps.hight=1:2:3", "steps.hight: expected one of"),
        ("steps.height=1:2", "expected FROM:TO:COUNT with FROM < TO"),
        ("steps.height=2:1:3", "expected FROM:TO:COUNT with FROM < TO"),
        ("steps.height=1:2:1", "a COUNT of 2 or more"),
        ("steps.height=1:2:2.5", "a COUNT of 2 or more"),
        ("steps.height=1:inf:3", "expected FROM:TO:COUNT"),
        ("steps.height=1:2:1e9", "expected at most 1000000 values"),
        ("steps.height=-5:2:3", "steps.height: expected float >= 0, found -5.0"),
        ("steps.height=tall", "steps.height: expected float"),
    ],
)
def test_a_wrong_grid_is_said_in_one_line(waist: Walk, text: str, says: str) -> None:
    with pytest.raises(PipelineError) as caught:
        parse_axis(text, waist.config)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_grid_names_each_parameter_once_and_is_not_too_large(waist: Walk) -> None:
    axis = parse_axis("steps.height=1:2:2000", waist.config)
    with pytest.raises(PipelineError, match="expected each parameter once, found steps.height"):
        make_grid([axis, axis])
    with pytest.raises(PipelineError, match="expected at least one parameter"):
        make_grid([])
    other = parse_axis("steps.swing=1:2:2000", waist.config)
    with pytest.raises(PipelineError, match="at most 1000000 settings, found 4000000: --random"):
        make_grid([axis, other])


def test_random_settings_are_inside_and_the_same_for_the_same_seed(waist: Walk) -> None:
    axes = axes_of(waist.config, ("steps.height=0.2:1:2", "steps.swing=0.5,0.9"))
    grid, again, other = (make_grid(axes, random=99, seed=s) for s in (3, 3, 4))
    assert grid.rows == again.rows != other.rows
    assert all(0.2 <= height <= 1 and swing in (0.5, 0.9) for height, swing in grid.rows)


def plain_grid(*counts: int) -> Grid:
    axes = [
        Axis("s", f"p{i}", "", tuple(map(float, range(n))), span=True, remeasure=False)
        for i, n in enumerate(counts)
    ]
    return make_grid(axes)


def test_of_equal_settings_the_middle_of_the_largest_plateau_is_taken() -> None:
    grid = plain_grid(9, 9)
    equal = np.zeros((9, 9), np.bool_)
    equal[2:7, 3:8] = True
    equal[0, 0] = True
    assert grid.rows[middle(grid, equal.ravel())] == (4.0, 5.0)
    line = plain_grid(7)
    assert middle(line, np.array([1, 1, 1, 1, 1, 0, 1], np.bool_)) == 2


def test_a_parameter_of_one_value_does_not_hide_the_plateau() -> None:
    grid = plain_grid(1, 5, 1)
    assert grid.rows[middle(grid, np.ones(5, np.bool_))] == (0.0, 2.0, 0.0)


def test_of_equal_random_settings_the_one_furthest_from_others_is_taken() -> None:
    axes = (Axis("s", "p", "", (0.0, 1.0), span=True, remeasure=False),)
    grid = Grid(axes, ((0.1,), (0.2,), (0.45,), (0.7,), (0.9,)), None)
    assert middle(grid, np.array([0, 1, 1, 1, 0], np.bool_)) == 2
    assert middle(grid, np.ones(5, np.bool_)) == 2


def test_the_front_is_what_nothing_beats() -> None:
    missed, false = np.array([5, 3, 3, 1, 0, 6, 0]), np.array([0, 2, 1, 9, 9, 0, 12])
    assert pareto_front(missed, false) == [(0, 9), (3, 1), (5, 0)]


def verdict(hits: str, *false_s: float) -> Verdicts:
    times = np.array([round(s * NS_PER_S) for s in false_s], np.int64)
    return Verdicts(np.array([c == "x" for c in hits]), times)


def test_the_bootstrap_is_deterministic_and_holds_the_score() -> None:
    settings = [[verdict("xxxxxxx.xx" * 6, 1, 2)], [verdict("xx..x.x.xx" * 6, 3)]]
    first, again = bootstrap(settings), bootstrap(settings)
    assert first.f1 == again.f1
    assert first.behind == again.behind
    for (verdicts,), interval in zip(settings, first.f1, strict=True):
        right, n = int(verdicts.hit.sum()), len(verdicts.hit)
        assert interval.low < 2 * right / (n + right + len(verdicts.false_ns)) < interval.high
    assert first.worse(1)
    assert not first.worse(0)


def test_equal_verdicts_are_not_told_apart_nor_are_small_differences() -> None:
    one = verdict("xxxxx.xxxx", 1)
    sure = bootstrap([[one, one], [one, one], [one, verdict("xxxxx.xxx.", 1)]])
    assert (sure.behind[1].low, sure.behind[1].high) == (0, 0)
    assert not sure.worse(1)
    assert not sure.worse(2)


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
