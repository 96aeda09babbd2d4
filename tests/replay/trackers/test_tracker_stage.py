"""Fixes become tracks: who belongs to whom, beginnings, ends, and what stays visible."""

from __future__ import annotations

import copy
import dataclasses
from typing import TYPE_CHECKING

import numpy as np
import pytest

from groundtrace.errors import PipelineError
from groundtrace.evaluation.tracks import score_tracks
from groundtrace.pipeline.chain import build_pipeline, wire
from groundtrace.pipeline.config import parse_pipeline
from groundtrace.pipeline.parameters import StageConfig, build
from groundtrace.pipeline.plugins import stage_named
from groundtrace.pipeline.stage import StageRunner
from groundtrace.trackers.walkers import COMMON, WalkersParameters, WalkerTracker
from groundtrace_codecs.events import (
    SMOOTHED,
    CandidateBlock,
    Event,
    Fix,
    Gap,
    Label,
    Note,
    StageSpec,
    TrackPoint,
)
from groundtrace_codecs.geometry import Geometry

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

UNKNOWN = (float("nan"),) * 3
SPEC = StageSpec("locate", "so-tdoa", "/s", ("all",), (), (), (), "fix")


def at(seconds: float) -> int:
    return 10**18 + round(seconds * 1e9)


def fix(seconds: float, x: float, y: float, stage: str = "locate") -> Fix:
    return Fix(at(seconds), x, y, UNKNOWN, 0.0, "so-tdoa", 9, stage)


def straight(count: int, start_s: float = 0.0, y: float = 0.0) -> list[Fix]:
    """Fixes of a walker along x, two steps a second."""
    return [fix(start_s + 0.5 * k, 0.35 * k, y) for k in range(count)]


def stage(**parameters: object) -> StageRunner:
    made = build(WalkersParameters, parameters, "track")
    sources = {WalkerTracker.takes[0]: ("locate",)}
    return StageRunner(StageConfig("walkers", "track"), WalkerTracker, made, sources)


def tracked(items: Iterable[Event], **parameters: object) -> list[Event]:
    runner = stage(**parameters)
    events = [event for item in [SPEC, *items] for event in runner.process(item)]
    return [*events, *runner.flush()]


def points(events: Iterable[Event], smooth: bool = False) -> list[TrackPoint]:
    name = "track" + SMOOTHED * smooth
    return [e for e in events if isinstance(e, TrackPoint) and e.stage == name]


def decided(events: Iterable[Event]) -> list[tuple[int, bool, float]]:
    """Time, verdict and distance of every fix."""
    blocks = [e for e in events if isinstance(e, CandidateBlock)]
    return [
        (int(t), bool(ok), float(v[0]))
        for b in blocks
        for t, ok, v in zip(b.time_ns, b.accepted, b.value, strict=True)
    ]


def test_a_walker_gives_a_point_for_every_step_filtered_and_then_smoothed() -> None:
    events = tracked(straight(6))
    assert isinstance(events[0], StageSpec)
    assert (events[0].emits, events[0].topic) == ("track", "/s")
    assert [p.time_ns for p in points(events)] == [f.time_ns for f in straight(6)]
    assert [p.time_ns for p in points(events, smooth=True)] == [f.time_ns for f in straight(6)]
    assert {p.track for p in points(events)} == {1}
    assert events[-6:] == points(events, smooth=True)


def test_points_have_place_velocity_covariance_and_nis() -> None:
    first, *_, last = points(tracked(straight(40)))
    assert (last.x_m, last.y_m) == pytest.approx((0.35 * 39, 0), abs=1e-3)
    assert (last.vx_mps, last.vy_mps) == pytest.approx((0.7, 0), abs=1e-3)
    assert last.covariance[0] == pytest.approx(0.471443 * 0.25, abs=1e-5)
    assert last.nis == pytest.approx(0, abs=1e-6)
    assert np.isnan((first.vx_mps, first.vy_mps, first.nis)).all()


def test_smoothed_points_hold_the_truth_as_they_say_where_fixes_err_alike_during_a_walk() -> None:
    random = np.random.default_rng(7)
    sigma_m, squares = WalkersParameters().sigma_r, []
    for _ in range(40):
        turns = np.cumsum(random.normal(0, WalkersParameters().sigma_q, (20, 2)), axis=0)
        walk = np.cumsum(turns + np.array([0.35, 0]), axis=0)
        alike = random.normal(0, sigma_m * COMMON**0.5, 2)
        places = walk + alike + random.normal(0, sigma_m * (1 - COMMON) ** 0.5, (20, 2))
        fixes = [fix(0.5 * k, x, y) for k, (x, y) in enumerate(places.tolist())]
        for point in points(tracked(fixes), smooth=True):
            off = walk[round((point.time_ns - at(0)) / 5e8)] - (point.x_m, point.y_m)
            xx, xy, yy = point.covariance
            squares.append(off @ np.linalg.inv([(xx, xy), (xy, yy)]) @ off)
    assert len(squares) > 700
    assert 0.6 < np.mean(np.array(squares) < -2 * np.log(1 - 0.68)) < 0.8


def test_without_smoothing_there_are_filtered_points_alone() -> None:
    events = tracked(straight(6), smooth=False)
    assert len(points(events)) == 6
    assert points(events, smooth=True) == []


def test_a_single_fix_is_no_track() -> None:
    events = tracked(straight(1))
    assert [e for e in events if isinstance(e, TrackPoint)] == []
    assert decided(events) == [(at(0), True, 0.0)]


def test_two_of_three_fixes_make_a_track() -> None:
    far = fix(0.5, 30, 30)
    assert len(points(tracked([fix(0, 0, 0), far, fix(1.0, 0.35, 0)], confirm=2))) == 2
    farther = fix(1.0, -30, 30)
    assert points(tracked([fix(0, 0, 0), far, farther, fix(1.5, 0.35, 0)], confirm=2)) == []


def test_two_steps_alone_are_no_confirmed_track_and_take_no_number() -> None:
    events = tracked([*straight(2), *straight(4, start_s=3.0)])
    assert all(ok for _, ok, _ in decided(events))
    assert [p.track for p in points(events)] == [1] * 4
    assert points(events)[0].time_ns == at(3.0)
    assert len(points(events, smooth=True)) == 4


def test_steps_of_an_unconfirmed_track_are_given_once_it_is_confirmed() -> None:
    said = tracked(straight(4))
    at_third = [e for e in said if isinstance(e, CandidateBlock | TrackPoint)]
    kinds = ["step" if isinstance(e, TrackPoint) else "fix" for e in at_third]
    assert kinds[:7] == ["fix", "fix", "fix", "step", "step", "step", "fix"]


def test_a_fix_that_does_not_fit_is_refused_and_stays_visible() -> None:
    walk = straight(10)
    walk[6] = fix(3.0, 2.1, 8.0)
    events = tracked(walk)
    assert [time for time, ok, _ in decided(events) if not ok] == [at(3.0)]
    assert next(d for time, _, d in decided(events) if time == at(3.0)) > 3.7
    assert at(3.0) not in [p.time_ns for p in points(events)]
    assert {p.track for p in points(events)} == {1}
    block = next(e for e in events if isinstance(e, CandidateBlock) and not e.accepted[0])
    assert block.value[0, 1:].tolist() == pytest.approx([0.5, 2.1, 8.0])
    assert block.margin[0, 0] == pytest.approx(3.7 - block.value[0, 0])


def test_a_track_ends_after_two_seconds_without_a_fix() -> None:
    events = tracked([*straight(4), *straight(4, start_s=3.6)])
    assert [p.track for p in points(events)] == [1] * 4 + [2] * 4
    events = tracked([*straight(4), fix(3.4, 1.4, 0)])
    assert {p.track for p in points(events)} == {1}


def test_a_clock_that_steps_ends_all_tracks() -> None:
    gap = Gap("/s", at(1.6), at(1.6), "clock step", 0)
    events = tracked([*straight(4), gap, *straight(4, start_s=-5)])
    assert [p.track for p in points(events)] == [1] * 4 + [2] * 4
    other = dataclasses.replace(gap, topic="/other")
    assert {p.track for p in points(tracked([*straight(4), other, fix(2, 1.4, 0)]))} == {1}


def test_a_walker_makes_no_second_step_within_the_least_pace() -> None:
    events = tracked([*straight(4), fix(1.7, 1.2, 0), fix(2.0, 1.4, 0)])
    assert [ok for _, ok, _ in decided(events)] == [True] * 4 + [False, True]


def test_fixes_that_come_together_are_of_different_walkers() -> None:
    apart = [f for k in range(6) for f in (fix(k / 2, 0.35 * k, 0), fix(k / 2 + 0.05, 0.35 * k, 3))]
    events = tracked(apart)
    assert {p.y_m for p in points(events) if p.track == 1} == {0}
    assert sorted({p.track for p in points(events)}) == [1, 2]


def test_the_own_covariance_of_a_fix_counts_if_asked_for() -> None:
    walk = [dataclasses.replace(f, covariance=(0.01, 0.0, 0.01)) for f in straight(8)]
    assert repr(points(tracked(walk))) == repr(points(tracked(straight(8))))
    sure = points(tracked(walk, own_covariance=True))[-1]
    assert sure.covariance[0] < 0.01
    unknown = points(tracked(straight(8), own_covariance=True))
    assert repr(unknown) == repr(points(tracked(straight(8))))


def crossing(
    rng: np.random.Generator, late_s: float, sigma: float
) -> tuple[list[Fix], list[Label], NDArray[np.float64]]:
    """Two walkers on the diagonals of a square: their fixes, the truth, and paths (2, 20, 2)."""
    steps = 0.35 * np.arange(20) / np.sqrt(2)
    paths = np.stack([np.stack([steps, steps], 1), np.stack([steps, steps[-1] - steps], 1)])
    fixes, labels = [], []
    for walker, path in enumerate(paths):
        for k, place in enumerate(path):
            seconds = 0.55 * k + late_s * walker
            x, y = place + rng.normal(0, sigma, 2)
            fixes.append(fix(seconds, float(x), float(y)))
            labels.append(Label(at(seconds), "step", x_m=float(place[0]), y_m=float(place[1])))
    fixes.sort(key=lambda f: f.time_ns)
    return fixes, labels, paths


@pytest.mark.parametrize("late_s", [0.02, 0.27])
def test_two_walkers_whose_paths_cross_keep_their_tracks(late_s: float) -> None:
    rng = np.random.default_rng(2)
    kept, distances = 0, []
    for _ in range(12):
        fixes, labels, paths = crossing(rng, late_s, 0.15)
        events = tracked(fixes, sigma_r=0.15, smooth=False)
        found = points(events)
        ends = [[p for p in found if p.track == number] for number in (1, 2)]
        same = [
            min((0, 1), key=lambda w: float(np.hypot(*(paths[w, k] - (p.x_m, p.y_m)))))
            for walk in ends
            for k, p in ((0, walk[0]), (-1, walk[-1]))
        ]
        kept += same[0] == same[1] and same[2] == same[3] and same[0] != same[2]
        # each at its own true times: OSPA counts a walker missed and one false as 2 m
        score = score_tracks(labels, found)
        assert score is not None
        distances.append(score.localisation_rmse_m)
        assert score.tracks == 2
        assert score.missed <= 2
    assert kept >= 10
    assert np.mean(distances) < 0.25


def test_ospa_of_crossing_walkers_is_that_of_their_places() -> None:
    """Walkers in step: truth has both at the same time, so OSPA compares pairs."""
    fixes, labels, _ = crossing(np.random.default_rng(4), 0.0, 0.15)
    score = score_tracks(labels, points(tracked(fixes, sigma_r=0.15)))
    assert score is not None
    assert (score.tracks, score.missed, score.false) == (2, 0, 0)
    assert score.ospa_m < 0.25
    assert score.gospa_m < 0.35
    smooth = score_tracks(labels, points(tracked(fixes, sigma_r=0.15), smooth=True))
    assert smooth is not None
    assert smooth.ospa_m < score.ospa_m


def test_a_copy_made_between_any_two_fixes_goes_on_as_the_stage_does() -> None:
    fixes, _, _ = crossing(np.random.default_rng(6), 0.02, 0.3)
    whole = tracked(fixes)
    for cut in (1, 2, 7, 20, 39):
        first = stage()
        events = [e for item in [SPEC, *fixes[:cut]] for e in first.process(item)]
        second = copy.deepcopy(first)
        for item in fixes[cut:]:
            list(first.process(item))
        events += [e for item in fixes[cut:] for e in second.process(item)]
        events += second.flush()
        # by text: what is unknown is NaN, which equals nothing
        assert repr(points(events)) == repr(points(whole))
        assert repr(points(events, smooth=True)) == repr(points(whole, smooth=True))
        assert decided(events) == decided(whole)


def test_fixes_of_other_stages_do_not_matter() -> None:
    others = [fix(0.5 * k + 0.1, 9.0, 9.0, "other") for k in range(6)]
    mixed = sorted([*straight(6), *others], key=lambda f: f.time_ns)
    assert repr(tracked(mixed)) == repr(tracked(straight(6)))


CHAIN = b"""name = "chain"
[[stage]]
use = "toa-cv"
[[stage]]
use = "coincidence"
[[stage]]
use = "so-tdoa"
[[stage]]
use = "power-law"
[[stage]]
use = "walkers"
"""


@pytest.mark.parametrize(
    ("line", "source"),
    [
        (b"", "so-tdoa"),
        (b'parameters = {source = "power-law"}\n', "power-law"),
        (b'source = ["power-law"]\n', "power-law"),
    ],
)
def test_a_tracker_takes_the_fixes_of_the_first_localizer_or_of_the_one_it_names(
    line: bytes, source: str
) -> None:
    config = parse_pipeline(CHAIN + line, "chain.toml")
    kinds = [stage_named(stage.use) for stage in config.stage]
    assert wire(config.stage, kinds)[-1] == {WalkerTracker.takes[0]: (source,)}


def test_a_source_that_gives_nothing_that_is_taken_is_refused() -> None:
    with pytest.raises(PipelineError, match=r"walkers.source: expected .*, found coincidence"):
        build_pipeline(parse_pipeline(CHAIN + b'source = ["coincidence"]\n', "chain.toml"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            CHAIN + b'parameters = {source = "nobody"}\n',
            "walkers.source: expected one of so-tdoa, power-law before a tracker, found nobody",
        ),
        (
            b'name = "lonely"\n[[stage]]\nuse = "walkers"\n',
            "walkers.source: expected a localizer before a tracker, found none",
        ),
    ],
)
def test_a_tracker_without_fixes_is_refused(text: bytes, message: str) -> None:
    with pytest.raises(PipelineError, match=f"^{message}$"):
        build_pipeline(parse_pipeline(text, "chain.toml"))


def test_a_fix_whose_localizer_doubts_its_model_is_no_step_of_a_track() -> None:
    walk = straight(12)
    doubted = [dataclasses.replace(x, doubted=k in (4, 5)) for k, x in enumerate(walk)]
    times = {p.time_ns for p in points(tracked(doubted))}
    assert times == {x.time_ns for x in doubted if not x.doubted}


#: Along x, and then along y.
PATHS = Geometry(paths=(((0.0, 0.0), (10.0, 0.0)), ((10.0, 0.0), (10.0, 5.0))))


def beside(count: int, off_m: float, **parameters: object) -> tuple[list[TrackPoint], list[Note]]:
    """Track fixes beside the first path; return the points and what is said of paths."""
    made = build(WalkersParameters, parameters, "track")
    sources = {WalkerTracker.takes[0]: ("locate",)}
    runner = StageRunner(StageConfig("walkers", "track"), WalkerTracker, made, sources, PATHS)
    items: list[Event] = [SPEC, *straight(count, y=off_m)]
    events = [event for item in items for event in runner.process(item)]
    return points([*events, *runner.flush()]), [e for e in events if isinstance(e, Note)]


def test_a_fix_near_a_path_is_drawn_to_it_as_far_as_walkers_stray() -> None:
    free, _ = beside(8, 0.5, path_sigma_m=0.0)
    near, notes = beside(8, 0.5, path_sigma_m=0.3)
    assert not notes
    for one, other in zip(free, near, strict=True):
        # a fix errs by 0.5 m: its weight beside the path is 0.09 / (0.09 + 0.25)
        assert one.y_m == pytest.approx(0.5)
        assert other.y_m == pytest.approx(0.5 * 0.09 / 0.34, abs=1e-6)
        assert other.x_m == pytest.approx(one.x_m)
        assert other.covariance[2] < one.covariance[2]
        assert other.covariance[0] == pytest.approx(one.covariance[0])


def test_who_walks_away_from_all_paths_is_left_there() -> None:
    free, _ = beside(6, 2.0, path_sigma_m=0.0)
    away, _ = beside(6, 2.0, path_sigma_m=0.3)
    assert [(p.x_m, p.y_m) for p in away] == [(p.x_m, p.y_m) for p in free]


def test_paths_that_nobody_keeps_to_are_told_once_and_count_no_more() -> None:
    there, notes = beside(20, 1.4, path_sigma_m=0.3)
    assert [note.level for note in notes] == ["WARN"]
    assert "not where the geometry's paths lead" in notes[0].text
    free, _ = beside(20, 1.4, path_sigma_m=0.0)
    assert there[0].y_m < 1.0 < there[-1].y_m
    assert there[-1].y_m == pytest.approx(free[-1].y_m, abs=0.2)


def test_paths_that_are_kept_to_again_count_again() -> None:
    made = build(WalkersParameters, {"path_sigma_m": 0.3}, "track")
    sources = {WalkerTracker.takes[0]: ("locate",)}
    runner = StageRunner(StageConfig("walkers", "track"), WalkerTracker, made, sources, PATHS)
    items: list[Event] = [SPEC, *straight(12, y=1.4), *straight(30, start_s=6.0)]
    events = [event for item in items for event in runner.process(item)]
    assert [e.level for e in events if isinstance(e, Note)] == ["WARN", "INFO"]
