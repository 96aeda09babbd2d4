"""The stage that navigates: chunks, gaps, faults, several feet, and the shipped pipeline."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from foot_walks import START_NS, Gait, Sensor, circle, foot_stream, foot_walk

from groundtrace.inertial.ins import FootNavigator
from groundtrace.inertial.strapdown import FootNavigatorParameters
from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import load_pipeline
from groundtrace.pipeline.conformance import FAULTS, rechunked
from groundtrace.pipeline.parameters import StageConfig
from groundtrace.pipeline.stage import StageRunner
from groundtrace_codecs.events import CandidateBlock, Gap, Note, StageSpec, StepEvent, TrackPoint

if TYPE_CHECKING:
    from groundtrace_codecs.signals import SignalBlock

NOISY = Sensor((0.1, 0.2, 0.3), (0.01, 0.0, -0.01), (0.0, 0.05, 0.0), 0.005, 0.05)
WALK = foot_walk(circle(6), NOISY, 100.0)


def stage(**changes: float) -> StageRunner:
    config = StageConfig("zupt-ins", "track")
    return StageRunner(config, FootNavigator, FootNavigatorParameters(**changes))


def said(items: list, runner: StageRunner | None = None) -> list:
    runner = runner or stage()
    return [event for item in items for event in runner.process(item)] + list(runner.flush())


def columns(events: list) -> list[tuple]:
    """Events as what can be compared exactly; NaN is None."""
    out: list[tuple] = []
    for e in events:
        if isinstance(e, TrackPoint):
            nis = None if np.isnan(e.nis) else e.nis
            out.append((e.stage, e.track, e.time_ns, e.x_m, e.y_m, e.vx_mps, *e.covariance, nis))
        elif isinstance(e, CandidateBlock):
            out.append((*e.time_ns.tolist(), *e.value.ravel().tolist(), *e.accepted.tolist()))
    return out


@pytest.mark.parametrize("samples", [1, 7, 333])
def test_any_blocks_give_the_very_same_track(samples: int) -> None:
    whole = columns(said([WALK.block]))
    assert columns(said(list(rechunked([WALK.block], samples)))) == whole
    assert len(whole) > 100


def test_a_copy_made_in_the_middle_goes_on() -> None:
    parts = list(rechunked([WALK.block], 150))
    first = stage()
    events = [event for part in parts[:4] for event in first.process(part)]
    second = copy.deepcopy(first)
    list(first.process(parts[4]))  # what the first does now does not concern the second
    assert columns(events + said(parts[4:], second)) == columns(said(parts))


def test_each_stance_is_a_candidate_with_its_verdict() -> None:
    events = said([WALK.block])
    (spec,) = [e for e in events if isinstance(e, StageSpec)]
    assert [g.name for g in spec.gates] == ["stillness", "distance", "speed"]
    blocks = [e for e in events if isinstance(e, CandidateBlock)]
    assert sum(int(b.accepted.sum()) for b in blocks) == 6
    for block in blocks:
        assert ((block.margin >= 0).all(axis=1) == block.accepted).all()
    begun = [e for e in events if isinstance(e, TrackPoint) and np.isfinite(e.nis)]
    assert [p.time_ns for p in begun] == [t for b in blocks for t in b.time_ns[b.accepted]]


def test_a_stance_that_does_not_fit_is_rejected_and_changes_no_place() -> None:
    events = said([WALK.block], stage(max_speed=1e-9, settle_s=1e3))
    blocks = [e for e in events if isinstance(e, CandidateBlock)]
    assert blocks
    assert not any(b.accepted.any() for b in blocks)


def test_a_filter_gone_astray_finds_back_when_the_foot_rests() -> None:
    samples = np.array(WALK.block.samples)
    samples[300:340, 3:] += 8.0  # a knock that the gyroscope does not survive
    walk = replace(WALK.block, samples=samples)
    points = [e for e in said([walk]) if isinstance(e, TrackPoint) and e.stage == "track"]
    assert np.hypot(points[-1].vx_mps, points[-1].vy_mps) < 0.05


def test_a_gap_ends_the_track_and_a_bridged_one_does_not() -> None:
    before, after = WALK.block.slice(0, 450), WALK.block.slice(450, len(WALK.block))
    for bridged, tracks in ((False, {1, 2}), (True, {1})):
        gap = Gap("/imu/foot", before.end_ns, after.start_ns, "missing", 1, bridged)
        points = [e for e in said([before, gap, after]) if isinstance(e, TrackPoint)]
        assert {p.track for p in points} == tracks


def with_losses(block: SignalBlock, spans: list[tuple[int, int]]) -> list:
    """The block with straight lines over lost samples, each after a gap that says so."""
    values, items, at = block.values.copy(), [], 0
    for start, end in spans:
        weight = np.arange(1, end - start + 1)[:, None] / (end - start + 1)
        values[start:end] = values[start - 1] + weight * (values[end] - values[start - 1])
    channels = tuple(replace(c, scale=1.0) for c in block.stream.channels)
    filled = replace(block, samples=values, stream=replace(block.stream, channels=channels))
    for start, end in spans:
        lost = filled.slice(start, end)
        gap = Gap(block.topic, lost.start_ns, lost.end_ns, "missing", end - start, bridged=True)
        items += [filled.slice(at, start), gap, lost]
        at = end
    return [*items, filled.slice(at, len(block))]


def test_lost_samples_make_a_track_less_sure_and_are_warned_of() -> None:
    begin, rng = 400, np.random.default_rng(0)
    spans = [(k, k + int(rng.integers(1, 9))) for k in range(begin, len(WALK.block) - 50, 40)]
    told = said(with_losses(WALK.block, spans))
    unsaid = said([item for item in with_losses(WALK.block, spans) if not isinstance(item, Gap)])
    tracks = [[e for e in events if isinstance(e, TrackPoint)] for events in (told, unsaid)]
    assert tracks[0][-1].covariance[0] > 1.5 * tracks[1][-1].covariance[0]
    (note,) = [e for e in told if isinstance(e, Note) and "were lost" in e.text]
    lost = sum(end - start for start, end in spans)
    assert note.text.startswith(f"/imu/foot: {lost} of {len(WALK.block)} samples were lost")
    assert note.level == "WARN"
    assert not [e for e in unsaid if isinstance(e, Note)]


@pytest.mark.parametrize("fault", sorted(FAULTS))
def test_faulty_samples_have_a_defined_outcome(fault: str) -> None:
    samples = FAULTS[fault](np.array(WALK.block.samples))
    events = said([replace(WALK.block, samples=samples)])
    points = [e for e in events if isinstance(e, TrackPoint)]
    assert np.isfinite([(p.x_m, p.y_m, *p.covariance) for p in points]).all()
    notes = [e.text for e in events if isinstance(e, Note)]
    assert any("not finite" in text for text in notes) == (fault != "clipped")


def test_feet_have_tracks_of_their_own_and_waists_none() -> None:
    names = {"/left": "foot", "/right": "foot", "/waist": "waist", "/unknown": ""}
    blocks = [
        replace(WALK.block, stream=foot_stream(100.0, topic, worn)) for topic, worn in names.items()
    ]
    events = said(blocks)
    assert [e.topic for e in events if isinstance(e, StageSpec)] == ["/left", "/right", "/unknown"]
    assert {e.track for e in events if isinstance(e, TrackPoint)} == {1, 2, 3}


def test_a_foot_without_gyroscope_gets_a_note_and_no_track() -> None:
    lame = WALK.block.select([0, 1, 2])
    (note,) = said([lame])
    assert note.text.startswith("/imu/foot: no track: expected three axes of")


def test_a_rate_too_low_for_swings_is_said() -> None:
    walk = foot_walk(Gait((0.0,) * 3), rate_hz=6.0)
    notes = [e.text for e in said([walk.block]) if isinstance(e, Note)]
    assert notes == ["/imu/foot: a swing of a foot needs 25 Hz to be followed, found 6"]


def test_nothing_comes_of_nothing() -> None:
    assert said([WALK.block.slice(0, 0)]) == []
    assert [e for e in said([WALK.block.slice(0, 1)]) if isinstance(e, TrackPoint)] == []


def test_the_shipped_pipeline_gives_strides_and_a_track() -> None:
    pipeline = build_pipeline(load_pipeline("foot-inertial"))
    blocks: list[SignalBlock] = list(rechunked([WALK.block], 50))
    events = [e for b in blocks for e in pipeline.process(b)] + list(pipeline.flush())
    steps = [e.time_ns for e in events if isinstance(e, StepEvent)]
    starts = START_NS + (np.arange(6) + 2.45) * 1e9
    assert len(steps) == 6
    assert np.abs(np.array(steps) - starts).max() < 0.2e9
    assert {e.stage for e in events if isinstance(e, TrackPoint)} == {"track", "track.smoothed"}
