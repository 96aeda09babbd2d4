"""Two walkers at once: whose step a fix is, and what the score of named targets says."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import pytest
from command_runs import done
from numpy.testing import assert_allclose

from groundtrace.evaluation.report import score_events
from groundtrace.evaluation.tracks import score_tracks
from groundtrace.pipeline.parameters import StageConfig, build
from groundtrace.pipeline.results import read_results
from groundtrace.pipeline.stage import StageRunner
from groundtrace.trackers.walkers import WalkersParameters, WalkerTracker
from groundtrace_codecs.events import CandidateBlock, Fix, Label, StageSpec, StepEvent, TrackPoint

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from groundtrace_codecs.events import Event

UNKNOWN = (float("nan"),) * 3
SPEC = StageSpec("locate", "so-tdoa", "/s", ("all",), (), (), (), "fix")
SIGMA = 0.2


def fix(seconds: float, x: float, y: float) -> Fix:
    return Fix(round(seconds * 1e9), x, y, UNKNOWN, 0.0, "so-tdoa", 9, "locate")


def tracked(fixes: Sequence[Fix]) -> list[Event]:
    parameters = build(WalkersParameters, {"sigma_q": SIGMA, "sigma_r": SIGMA}, "track")
    runner = StageRunner(
        StageConfig("walkers", "track"),
        WalkerTracker,
        parameters,
        {WalkerTracker.takes[0]: ("locate",)},
    )
    events = [e for item in [SPEC, *fixes] for e in runner.process(item)]
    return [*events, *runner.flush()]


def points(events: Sequence[Event]) -> list[TrackPoint]:
    return [e for e in events if isinstance(e, TrackPoint) and e.stage == "track"]


def refused(events: Sequence[Event]) -> list[tuple[float, list[str]]]:
    """Times of the fixes that joined no track, and the gates that kept them out."""
    return [
        (t / 1e9, [g.name for g, m in zip(b.spec.gates, margin, strict=True) if m < 0])
        for b in events
        if isinstance(b, CandidateBlock)
        for t, margin, ok in zip(b.time_ns.tolist(), b.margin, b.accepted, strict=True)
        if not ok
    ]


def straight(count: int, y: float = 0.0, start_s: float = 0.0) -> list[Fix]:
    return [fix(start_s + 0.5 * k, 0.5 * k, y) for k in range(count)]


def merged(*walks: Sequence[Fix]) -> list[Fix]:
    return sorted((f for walk in walks for f in walk), key=lambda f: f.time_ns)


@pytest.mark.parametrize("late_s", [0.09, 0.13])
def test_a_toe_joins_no_track_and_begins_none(late_s: float) -> None:
    heels = straight(8)
    toes = [fix(f.time_ns / 1e9 + late_s, f.x_m + 0.2, f.y_m + 0.1) for f in heels]
    events = tracked(merged(heels, toes))
    assert [p.time_ns for p in points(events)] == [f.time_ns for f in heels]
    assert {p.track for p in points(events)} == {1}
    assert refused(events) == [(toe.time_ns / 1e9, ["since"]) for toe in toes]


@pytest.mark.parametrize("late_s", [0.03, 0.09, 0.2, 0.35])
def test_another_walker_may_step_at_any_time(late_s: float) -> None:
    events = tracked(merged(straight(8), straight(8, y=2.5, start_s=late_s)))
    for number, y in ((1, 0.0), (2, 2.5)):
        walk = [p for p in points(events) if p.track == number]
        assert len(walk) == 8
        assert_allclose([p.y_m for p in walk], y, atol=1e-9)


def test_a_stranger_is_said_to_be_too_far_from_the_nearest_track() -> None:
    events = tracked(merged(straight(6), [fix(2.2, 1.0, 4.0)]))
    assert refused(events) == [(2.2, ["distance", "since"])]
    block = next(e for e in events if isinstance(e, CandidateBlock) and not e.accepted[-1])
    assert np.isfinite(block.margin).all()


def test_a_walker_who_turns_about_keeps_his_track() -> None:
    there = straight(9)
    back = [fix(4.5 + 0.5 * k, 3.5 - 0.5 * k, 0.0) for k in range(7)]
    events = tracked([*there, *back])
    assert refused(events) == []
    assert {p.track for p in points(events)} == {1}
    assert points(events)[-1].x_m == pytest.approx(0.5, abs=0.15)


def test_steps_that_are_missed_do_not_end_a_track() -> None:
    walk = straight(14)
    del walk[7:9]
    events = tracked(walk)
    assert refused(events) == []
    after = next(p for p in points(events) if p.time_ns == walk[7].time_ns)
    assert (after.track, after.x_m) == (1, pytest.approx(4.5, abs=0.02))
    assert after.vx_mps == pytest.approx(1.0, abs=0.05)
    smooth = [e for e in events if isinstance(e, TrackPoint) and e.stage != "track"]
    assert_allclose([p.x_m for p in smooth[1:]], [f.x_m for f in walk[1:]], atol=0.05)


def test_a_track_that_just_began_takes_no_fix_from_one_that_counts() -> None:
    walk = straight(12)
    walk[6] = fix(3.0, 3.0, 2.4)  # 2.4 m off: out of reach, so that it begins a track
    walk[7] = fix(3.5, 3.5, 0.7)
    events = tracked(walk)
    assert [t for t, _ in refused(events)] == [3.0]
    assert {p.track for p in points(events)} == {1}


def crossing(seed: int, late_s: float) -> tuple[list[Fix], list[Label]]:
    """Two walkers on the diagonals of a square of 6 m, who meet in the middle if late_s is 0."""
    rng = np.random.default_rng(seed)
    fixes, labels = [], []
    for target, (rise, offset) in {"A": (1, 0.0), "B": (-1, 6.0)}.items():
        times = late_s * (target == "B") + np.cumsum(rng.normal(0.55, 0.02, 20))
        for k, seconds in enumerate(times.tolist()):
            x, y = 0.3 * k, offset + rise * 0.3 * k
            x_error, y_error = rng.normal(0, 0.18, 2).tolist()
            fixes.append(fix(seconds, x + x_error, y + y_error))
            labels.append(Label(round(seconds * 1e9), "step", x_m=x, y_m=y, target=target))
    return merged(fixes), sorted(labels)


def test_crossing_walkers_keep_their_tracks_and_ospa_says_so() -> None:
    found = []
    for seed in range(10):
        for late_s in (0.05, 0.12, 0.27):
            fixes, labels = crossing(seed, late_s)
            score = score_tracks(labels, points(tracked(fixes)))
            assert score is not None
            assert score.identity is not None
            found.append((score.ospa_m, score.gospa_m, score.completeness, score.identity.idf1))
    ospa_m, gospa_m, completeness, idf1 = np.mean(found, axis=0)
    assert ospa_m < 0.4
    assert gospa_m < 0.5
    assert completeness > 0.95
    assert idf1 > 0.85


def line(target: str, y: float, phase_s: float) -> list[Label]:
    times = phase_s + 0.5 * np.arange(11)
    return [
        Label(round(t * 1e9), "step", x_m=float(t), y_m=y, target=target) for t in times.tolist()
    ]


def following(number: int, labels: Sequence[Label]) -> list[TrackPoint]:
    return [
        TrackPoint(x.time_ns, number, x.x_m or 0.0, x.y_m or 0.0, 0, 0, UNKNOWN, "track")
        for x in labels
    ]


def test_named_targets_are_there_between_their_steps() -> None:
    a, b = line("a", 0.0, 0.0), line("b", 4.0, 0.2)
    score = score_tracks(sorted([*a, *b]), [*following(1, a), *following(2, b)])
    assert score is not None
    # the first time is before b begins, the last after a ends
    assert (score.times, score.missed, score.false) == (22, 0, 0)
    assert score.ospa_m == pytest.approx(0.0, abs=1e-9)
    assert score.identity is not None
    assert (score.identity.switches, score.identity.idf1) == (0, 1.0)
    assert [(t.target, t.track, t.times) for t in score.identity.targets] == [
        ("a", 1, 21),
        ("b", 2, 21),
    ]


def test_tracks_that_swap_their_targets_are_two_switches() -> None:
    a, b = line("a", 0.0, 0.0), line("b", 4.0, 0.0)
    swapped = [*following(1, [*a[:6], *b[6:]]), *following(2, [*b[:6], *a[6:]])]
    score = score_tracks(sorted([*a, *b]), swapped)
    assert score is not None
    assert score.ospa_m == pytest.approx(0.0)
    assert score.identity is not None
    assert score.identity.switches == 2
    assert score.identity.idf1 == pytest.approx(6 / 11)


def test_one_target_whose_track_breaks_has_a_switch_and_nameless_crowds_have_no_identity() -> None:
    walk = line("", 0.0, 0.0)
    score = score_tracks(walk, [*following(1, walk[:4]), *following(2, walk[4:])])
    assert score is not None
    assert score.identity is not None
    (only,) = score.identity.targets
    assert (only.target, only.switches, only.track, only.own, only.rmse_m) == ("", 1, 2, 7, 0.0)
    crowd = sorted([*walk, *line("", 4.0, 0.0)])
    score = score_tracks(crowd, following(1, walk))
    assert score is not None
    assert score.identity is None


@pytest.mark.parametrize(("pipeline", "least"), [("room-two-walkers", 0.75)])
def test_two_walkers_come_out_of_a_recording(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], pipeline: str, least: float
) -> None:
    recording, results = tmp_path / "two.mcap", tmp_path / "two.results.mcap"
    done(capsys, "simulate", "room", "--walkers", 2, "--seed", 204, "--out", recording)
    done(capsys, "replay", recording, "--pipeline", pipeline, "--no-viewer", "--out", results)
    found = read_results(results)
    times = [x.time_ns for x in found.labels if x.kind == "step"]
    score = score_events(found.labels, found.events, times[0], times[-1])
    assert score.steps is not None
    assert score.steps.recall > least
    assert score.steps.precision > 0.9
    steps = sorted(e.time_ns for e in found.events if isinstance(e, StepEvent))
    assert any(b - a < 250_000_000 for a, b in pairwise(steps))
    assert score.track is not None
    assert score.track.identity is not None
    assert [t.target for t in score.track.identity.targets] == ["1", "2"]
    assert score.track.tracks == 2
    assert score.track.gospa_m < 0.8
