"""Whether a recording and a pipeline suit each other, and placements that nobody states."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from groundtrace.errors import PipelineError
from groundtrace.evaluation.steps import score_steps
from groundtrace.explain.suitability import prepared, refuse_unsuitable, with_placements
from groundtrace.explain.sweep import measure_evidence
from groundtrace.pipeline.config import build_pipeline, load_pipeline, parse_pipeline, with_settings
from groundtrace.pipeline.conformance import rechunked
from groundtrace.pipeline.engine import EventList, replay
from groundtrace.pipeline.source import Source
from groundtrace_codecs.events import StepEvent
from groundtrace_codecs.importers.run import import_recording
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import Channel, SignalBlock, Stream
from groundtrace_codecs.writer import write_recording

if TYPE_CHECKING:
    from pathlib import Path

NS = 10**9
RATE_HZ = 50.0
WALKER = load_pipeline("waist-steps")


def body(seconds: float = 40.0, swing_deg: float = 6.0) -> np.ndarray:
    """Force and turning of a sensor that nods by some degrees; its x axis points up."""
    t = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    stride = 2 * np.pi * t / 1.07
    angle = np.radians(swing_deg) * np.sin(stride)
    bob = 2.0 * np.cos(2 * stride) + 1.0 * np.cos(4 * stride + 1.0)
    none = np.zeros_like(t)
    felt = [9.81 * np.cos(angle) + bob, none, 9.81 * np.sin(angle)]
    return np.stack([*felt, none, np.gradient(angle, t), none], axis=1)


def stream(placement: str = "", topic: str = "/imu") -> Stream:
    channels = [Channel(f"acc_{a}", "acceleration", "m/s2", a) for a in "xyz"]
    channels += [Channel(f"gyr_{a}", "angular_velocity", "rad/s", a) for a in "xyz"]
    return Stream(topic, tuple(channels), RATE_HZ, placement)


def written(path: Path, samples: np.ndarray, placement: str = "") -> Path:
    worn = stream(placement)
    block = SignalBlock(worn, 1_700_000_000 * NS, 0, samples[:, : len(worn.channels)])
    write_recording(path, [(worn, "f64le", rechunked([block], 40))], force=True)
    return path


def steps(path: Path, config) -> list[int]:
    sink = EventList()
    with Recording.open(path) as opened:
        replay(Source(opened), prepared(config, opened).chain, [sink])
    return [event.time_ns for event in sink.events if isinstance(event, StepEvent)]


def geophones() -> Stream:
    return Stream("/geo", (Channel("G1", "ground_velocity", "m/s", "z"),), 500.0)


def test_a_pipeline_that_fits_no_quantity_is_refused_with_those_that_fit() -> None:
    with pytest.raises(PipelineError) as error:
        refuse_unsuitable(WALKER, [geophones()], "r.mcap")
    text = str(error.value)
    assert text.startswith(
        "r.mcap: pipeline waist-steps: expected acceleration or acceleration_magnitude, found "
        "/geo (ground_velocity); pipelines that fit: "
    )
    fitting = text.rpartition(": ")[2].split(", ")
    assert {"hammer-shots", "room-footsteps", "vehicle-passes"} <= set(fitting)
    assert not {"waist-steps", "pedestrian", "foot-inertial", "signals"} & set(fitting)
    for name in fitting:
        refuse_unsuitable(load_pipeline(name), [geophones()], "r.mcap")


def test_a_pipeline_that_finds_something_or_wants_nothing_is_taken() -> None:
    refuse_unsuitable(WALKER, [geophones(), stream()], "r.mcap")
    refuse_unsuitable(load_pipeline("signals"), [geophones()], "r.mcap")


def test_an_accelerometer_alone_does_not_suit_what_needs_a_gyroscope_too() -> None:
    force = stream().select([0, 1, 2])
    with pytest.raises(PipelineError, match="expected angular_velocity and acceleration"):
        refuse_unsuitable(load_pipeline("heading"), [force], "r.mcap")
    refuse_unsuitable(load_pipeline("pedestrian"), [force], "r.mcap")  # its steps are found


def test_topics_that_match_nothing_are_named() -> None:
    other = replace(WALKER, stage=(replace(WALKER.stage[0], topics=("/wrist*",)),))
    with pytest.raises(PipelineError, match=r"acceleration_magnitude on /wrist\*, found /imu"):
        refuse_unsuitable(other, [stream()], "r.mcap")


def test_a_sure_guess_decides_as_the_placement_stated_would(tmp_path: Path) -> None:
    samples = body()
    unstated = written(tmp_path / "unstated.mcap", samples)
    stated = written(tmp_path / "stated.mcap", samples, "trunk")
    with Recording.open(unstated) as opened:
        ready = prepared(WALKER, opened)
    (note,) = ready.notes
    assert note.level == "WARN"
    assert note.text.startswith("placement of /imu not stated: taken for waist or trunk (0.")
    assert note.text.endswith("; --set steps.placement=PLACE or placement in the map states it")
    assert ready.chain.config.placements == {"/imu": "trunk"}
    assert ready.asked == WALKER
    taken = steps(unstated, WALKER)
    assert taken == steps(stated, WALKER)
    assert taken == steps(unstated, with_settings(WALKER, ["steps.placement=waist"]))
    assert taken != steps(unstated, with_settings(WALKER, ["steps.placement=phone"]))


def test_an_unsure_guess_and_too_little_walking_leave_the_defaults(tmp_path: Path) -> None:
    unsure = written(tmp_path / "unsure.mcap", body(swing_deg=15.0))
    short = written(tmp_path / "short.mcap", body(8.0))
    for path, said in ((unsure, "is not sure, default timing"), (short, "too little walking")):
        with Recording.open(path) as opened:
            placed, (line,), topics = with_placements(WALKER, opened)
        assert placed.placements == {"/imu": ""}
        assert topics == ("/imu",)
        assert said in line
        assert steps(path, WALKER) == steps(path, with_settings(WALKER, ["steps.placement=phone"]))


def test_without_a_gyroscope_a_guess_must_be_surer() -> None:
    from groundtrace.inertial.placement import Measures, guessed

    half = Measures(60.0, 2.0, 0.9, 0.9, 0.02, 13.0, 0.05, 0.1)
    blind = replace(half, turning_radps=None, swinging_radps=None, rests=None)
    assert guessed(half).site == guessed(blind).site == "trunk"
    assert 0.5 < guessed(blind).confidence < 0.7
    assert not guessed(blind).sure
    assert guessed(half).confidence > 0.5
    assert guessed(half).sure


def test_what_is_stated_or_set_or_asked_for_by_nobody_is_not_guessed(tmp_path: Path) -> None:
    stated = written(tmp_path / "stated.mcap", body(), "wrist")
    unstated = written(tmp_path / "unstated.mcap", body())
    asked = ((stated, WALKER), (unstated, load_pipeline("waist-peaks")))
    for path, config in (*asked, (unstated, with_settings(WALKER, ["steps.placement=phone"]))):
        with Recording.open(path) as opened:
            assert with_placements(config, opened) == (config, [], ())


def test_the_guess_is_in_the_recipe_and_counts_when_it_is_measured_again(tmp_path: Path) -> None:
    path = written(tmp_path / "walk.mcap", body())
    evidence = measure_evidence(path, WALKER)
    assert evidence.config.placements == {"/imu": "trunk"}
    with Recording.open(path) as opened:
        recipe = prepared(WALKER, opened).chain.recipe()
    assert 'placements = {"/imu" = "trunk"}' in recipe
    again = parse_pipeline(recipe.encode(), "recipe")
    assert again.placements == {"/imu": "trunk"}
    assert build_pipeline(again).recipe() == recipe
    assert steps(path, again) == steps(path, WALKER)
    # what the recipe says counts, also where it was looked for and not known
    unknown = replace(again, placements={"/imu": ""})
    with Recording.open(path) as opened:
        placed, (line,), _ = with_placements(unknown, opened)
    assert placed == unknown
    assert "nor does the pipeline" in line
    assert steps(path, unknown) != steps(path, WALKER)


def test_the_guess_does_not_depend_on_the_part_that_is_replayed(tmp_path: Path) -> None:
    path = written(tmp_path / "walk.mcap", body())
    whole, late = [], []
    for found, start_ns in ((whole, None), (late, 1_700_000_020 * NS)):
        sink = EventList()
        with Recording.open(path) as opened:
            chain = prepared(WALKER, opened).chain
            replay(Source(opened, start_ns=start_ns, block_s=0.0), chain, [sink])
        found += [e.time_ns for e in sink.events if isinstance(e, StepEvent)]
    settled = 1_700_000_030 * NS
    late, whole = ([t for t in times if t > settled] for times in (late, whole))
    assert len(late) == len(whole) > 10
    # what the forward axis remembers of the part before moves them by milliseconds
    np.testing.assert_allclose(late, whole, rtol=0, atol=2e7)


@pytest.mark.parametrize("block_s", [0.0, 0.1, 7.0])
def test_blocks_of_any_length_give_the_same_steps(tmp_path: Path, block_s: float) -> None:
    path = written(tmp_path / "walk.mcap", body())
    sink = EventList()
    with Recording.open(path) as opened:
        replay(Source(opened, block_s=block_s), prepared(WALKER, opened).chain, [sink])
    assert [e.time_ns for e in sink.events if isinstance(e, StepEvent)] == steps(path, WALKER)


def test_a_real_walk_that_states_no_placement_is_timed_as_with_it(
    data: Path, tmp_path: Path
) -> None:
    walk = data / "back-steps" / "3-3"
    if not walk.is_dir():
        pytest.skip("back-steps is absent")
    columns, path = tmp_path / "map.toml", tmp_path / "walk.mcap"
    columns.write_text((walk / "map.toml").read_text().replace('"a.u."', '"count"'))
    import_recording([walk / "signal.csv"], path, map_path=columns, truth=walk / "truth.csv")
    with Recording.open(path) as opened:
        labels, span = opened.labels, (opened.start_ns, opened.end_ns)

    def f1(*settings: str) -> float:
        found = np.array(sorted(steps(path, with_settings(WALKER, settings))), np.int64)
        score = score_steps(labels, found, *span, 0.12)
        assert score is not None
        return score.f1

    stated = f1("steps.placement=waist")
    assert f1() == stated
    assert f1("steps.placement=phone") < stated - 0.3
