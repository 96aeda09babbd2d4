"""What a result is scored against, and which of its stages."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from command_runs import check_schema, done, run

from groundtrace.errors import RecordingError
from groundtrace.evaluation.report import answers_of, score_events
from groundtrace.evaluation.truth import foot_of, scored_truth
from groundtrace.pipeline.engine import ReplaySession
from groundtrace.pipeline.results import Provenance, Results, ResultsSink, given_to
from groundtrace_codecs.events import (
    Disturbance,
    Event,
    Heading,
    Label,
    StageSpec,
    StepEvent,
    TrackPoint,
)
from groundtrace_codecs.signals import NS_PER_S

if TYPE_CHECKING:
    from pathlib import Path

END_NS = 60 * NS_PER_S
RECIPE = """
name = "walk"
[[stage]]
name = "track"
use = "reckoning"
[stage.parameters]
updates = "{}"
"""
WAYPOINTS = tuple(
    Label(10 * k * NS_PER_S, "waypoint", x_m=10.0 * k, y_m=0.0, label=f"{k}") for k in range(6)
)


def spec(stage: str, emits: str, topic: str = "/imu") -> StageSpec:
    return StageSpec(stage, stage, topic, ("all",), (), (), (), emits)


def points(stage: str, noise_m: float) -> list[TrackPoint]:
    rng = np.random.default_rng(1)
    return [
        TrackPoint(
            k * NS_PER_S // 2,
            1,
            k / 2 + float(rng.normal(0, noise_m)),
            0.0,
            1.0,
            0.0,
            (0.1, 0.0, 0.1),
            stage,
        )
        for k in range(121)
    ]


def result(events: list[Event], updates: str = "none", placement: str = "") -> Results:
    pipeline = RECIPE.format(updates)
    origin = Provenance("w.mcap", "ab" * 32, 0, END_NS, pipeline)
    origin = replace(origin, placements={"/imu": placement} if placement else {})
    given = given_to(pipeline, WAYPOINTS)
    return Results("w", origin, WAYPOINTS, None, tuple(events), given=given)


TRACKED: list[Event] = [
    spec("track", "track"),
    *points("track", 5.0),
    *points("track.smoothed", 0.1),
]


def test_the_smoothed_track_is_scored_and_the_jumps_of_the_other_are_no_way() -> None:
    score = score_events(WAYPOINTS, TRACKED, 0, END_NS)
    assert score.track is not None
    assert score.track.stage == "track.smoothed"
    assert score.track.closure is not None
    assert score.track.closure.walked_m == pytest.approx(50, abs=10)


def test_a_stage_is_chosen() -> None:
    score = score_events(WAYPOINTS, TRACKED, 0, END_NS, stages=["track"])
    assert score.track is not None
    assert score.track.stage == "track"
    assert score.track.closure is not None
    assert score.track.closure.walked_m > 200


def test_a_chosen_stage_of_steps_leaves_other_kinds_alone() -> None:
    events = [
        *TRACKED,
        spec("one", "step"),
        spec("other", "step"),
        *(StepEvent(k * NS_PER_S, "step", "", "/imu", "one", 1.0) for k in range(3)),
        *(StepEvent(k * NS_PER_S, "step", "", "/imu", "other", 1.0) for k in range(5)),
    ]
    assert len(answers_of(events).steps) == 5
    said = answers_of(events, ["one"])
    assert len(said.steps) == 3
    assert {p.stage for p in said.points} == {"track.smoothed"}


def test_a_stage_that_answers_nothing_is_refused_with_those_that_do() -> None:
    with pytest.raises(
        RecordingError, match=r"--stage: expected one of track, track\.smoothed, found nosuch"
    ):
        answers_of(TRACKED, ["nosuch"])


@pytest.mark.parametrize(("updates", "left"), [("none", 6), ("first-two", 4), ("waypoints", 0)])
def test_waypoints_that_were_given_are_not_scored(updates: str, left: int) -> None:
    found = scored_truth(WAYPOINTS, result(TRACKED, updates))
    assert [x.kind for x in found.labels] == ["waypoint"] * left
    assert found.given == 6 - left
    said = f"{6 - left} of 6 waypoints were given to the pipeline: not scored"
    assert found.remarks == ((said,) if left < 6 else ())
    score = score_events(found.labels, TRACKED, 0, END_NS)
    assert (score.track is None) == (left == 0)


def test_labels_of_a_kind_that_another_program_made_up_are_said_not_to_count() -> None:
    labels = [Label(k * NS_PER_S, kind) for k, kind in enumerate(("step", "footstep", "footstep"))]
    found = scored_truth(labels, result([spec("one", "step")], "none"))
    assert len(found.labels) == 3
    (said,) = found.remarks
    assert said.startswith("labels of kind 'footstep': 2, not scored: expected one of count, ")
    assert said.endswith("; did you mean step?")


def feet() -> list[Label]:
    return [Label(k * NS_PER_S, "step", label=("left", "right")[k % 2]) for k in range(1, 41)] + [
        Label(0, "count", end_ns=END_NS, value=40.0)
    ]


@pytest.mark.parametrize(
    ("placement", "truth", "remark"),
    [
        ("left foot", 20, "is on the left foot: the truth of that foot alone is scored"),
        ("right foot", 20, "is on the right foot: the truth of that foot alone is scored"),
        ("foot", 40, "does not state which one it is on: expected left foot or right foot"),
        ("waist", 40, ""),
        ("", 40, ""),
    ],
)
def test_a_foot_is_scored_against_its_own_steps(placement: str, truth: int, remark: str) -> None:
    side = 1 if placement == "right foot" else 0
    steps = [
        StepEvent((2 * k + (1 if side else 2)) * NS_PER_S, "step", "", "/imu", "steps", 1.0)
        for k in range(20)
    ]
    given = result([spec("steps", "step"), *steps], placement=placement)
    found = scored_truth(feet(), given)
    assert remark in " ".join(found.remarks)
    assert bool(found.remarks) == bool(remark)
    score = score_events(found.labels, given.events, 0, END_NS)
    assert score.steps is not None
    assert (score.steps.truth, score.steps.matched) == (truth, 20)
    assert score.steps.count_truth == truth


def test_what_is_left_out_is_in_the_json_and_on_the_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "w.results.mcap"
    steps = [StepEvent(2 * k * NS_PER_S, "step", "", "/imu", "steps", 1.0) for k in range(1, 20)]
    made = result([], "first-two", "right foot").provenance
    sink = ResultsSink(path, made)
    labels = (*WAYPOINTS, *feet())
    sink.open(ReplaySession("w.mcap", "walker", 0, END_NS, (), None, labels, made.pipeline))
    for event in (spec("steps", "step"), *steps, *TRACKED):
        sink.write(event)
    sink.close()
    page = tmp_path / "page.html"
    ran = done(capsys, "score", path, "--json", "--html", page)
    check_schema("score", ran.document)
    said = ran.document["truth"]
    assert (said["waypoints_given"], said["foot"]) == (2, "right")
    assert len(said["remarks"]) == 2
    for remark in said["remarks"]:
        assert f"truth: {remark}" in ran.err
        assert f"Truth: {remark}." in page.read_text("utf-8")
    assert ran.document["steps"]["truth"] == 20
    assert ran.document["track"]["waypoints"]["n"] == 4
    chosen = done(capsys, "score", path, "--json", "--stage", "track").document
    assert chosen["track"]["stage"] == "track"


def impacts() -> list[Label]:
    return [Label(k * NS_PER_S, "impact", x_m=1.0 * k, y_m=0.0, label=f"{k}") for k in range(1, 9)]


def test_impacts_are_what_steps_are_scored_against_where_truth_has_no_steps() -> None:
    steps = [StepEvent(k * NS_PER_S, "step", "", "/floor", "steps", 1.0) for k in range(1, 8)]
    given = result([spec("steps", "step", "/floor"), *steps])
    found = scored_truth(impacts(), given)
    said = "8 impacts and no steps: the impacts are what steps are scored against"
    assert found.remarks == (said,)
    score = score_events(found.labels, given.events, 0, END_NS)
    assert score.steps is not None
    assert (score.steps.truth, score.steps.detected, score.steps.matched) == (8, 7, 7)
    # each keeps its place and its name
    assert [(x.x_m, x.label) for x in found.labels] == [(x.x_m, x.label) for x in impacts()]


@pytest.mark.parametrize("other", ["step", "count", "pass"])
def test_impacts_beside_steps_counts_or_vehicles_stay_what_they_are(other: str) -> None:
    labels = [*impacts(), Label(20 * NS_PER_S, other, end_ns=END_NS, value=1.0)]
    found = scored_truth(labels, result([spec("steps", "step")]))
    assert found.labels == tuple(labels)
    assert found.remarks == ()


def test_impacts_stay_what_they_are_where_no_stage_finds_steps() -> None:
    found = scored_truth(impacts(), result([spec("picks", "pick")]))
    assert [x.kind for x in found.labels] == ["impact"] * 8


def test_score_why_and_sweep_of_a_room_that_was_struck_take_its_impacts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    made = ("--impacts", "--steps", "5", "--channels", "4", "--rate-hz", "5000", "--seed", "3")
    done(capsys, "simulate", "room", *made, "--out", "struck.mcap")
    done(capsys, "replay", "struck.mcap", "--pipeline", "room-footsteps", "--no-viewer")
    ran = done(capsys, "score", "struck.results.mcap", "--json")
    assert (ran.document["steps"]["truth"], ran.document["steps"]["matched"]) == (5, 5)
    assert ran.document["positions"]["truth"] == 5
    assert "truth: 5 impacts and no steps" in ran.err
    assert "5 right, 0 missed" in done(capsys, "why", "struck.results.mcap").out
    done(capsys, "sweep", "struck.results.mcap", "--grid", "steps.min_channels=2:4:3")
    done(capsys, "replay", "struck.mcap", "--pipeline", "hammer-shots", "--no-viewer", "--force")
    said = run(capsys, "why", "struck.results.mcap", "--kind", "steps").error
    assert (
        "expected true steps (in the recording, or --truth FILE), found 5 impact, 20 pick" in said
    )


def test_truth_that_names_types_of_steps_names_no_feet() -> None:
    labels = [
        Label(k * NS_PER_S, "step", label=("left", "right", "forward")[k % 3]) for k in range(1, 30)
    ]
    given = result([spec("steps", "step")], placement="left foot")
    assert scored_truth(labels, given).labels == tuple(labels)


@pytest.mark.parametrize(
    ("placement", "foot"),
    [
        ("left foot", "left"),
        ("foot_right", "right"),
        ("Right-Foot", "right"),
        ("foot", "both"),
        ("left wrist", ""),
        ("waist", ""),
    ],
)
def test_a_placement_names_a_foot(placement: str, foot: str) -> None:
    assert foot_of(placement) == foot


def test_a_result_without_a_stage_of_steps_has_no_steps_part() -> None:
    labels = [*feet(), Label(NS_PER_S, "heading", value=0.0)]
    events: list[Event] = [spec("heading", "heading"), Heading(NS_PER_S, 0.0, 0.1, "heading")]
    score = score_events(labels, events, 0, END_NS)
    assert score.steps is None
    assert score.heading is not None
    looked = score_events(labels, [*events, spec("steps", "step")], 0, END_NS)
    assert looked.steps is not None
    assert looked.steps.matched == 0


def test_disturbances_without_a_true_one_are_seconds_of_false_alarm() -> None:
    events = [spec("heading", "heading"), Disturbance(NS_PER_S, 4 * NS_PER_S, 1.0, "heading")]
    score = score_events(feet(), events, 0, END_NS).disturbance
    assert score is not None
    assert score.false_alarm_s == pytest.approx(3)
    assert score.scored_s == pytest.approx(60, abs=0.02)
    assert (score.precision, score.recall, score.f1) == (0.0, None, None)
    assert score_events([], events, 0, END_NS).disturbance is None


def test_a_true_disturbance_that_the_stage_misses_has_no_recall() -> None:
    labels = [Label(NS_PER_S, "disturbed", end_ns=4 * NS_PER_S)]
    score = score_events(labels, [spec("heading", "heading")], 0, END_NS).disturbance
    assert score is not None
    assert (score.stage, score.precision, score.recall, score.f1) == ("heading", None, 0.0, 0.0)
