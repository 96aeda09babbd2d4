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
from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import (
    load_pipeline,
    named_pipelines,
    parse_pipeline,
    with_settings,
)
from groundtrace.pipeline.conformance import rechunked
from groundtrace.pipeline.engine import EventList, replay
from groundtrace.pipeline.plugins import stage_named
from groundtrace.pipeline.source import Source
from groundtrace_codecs.events import StepEvent
from groundtrace_codecs.geometry import Geometry, Sensor
from groundtrace_codecs.importers.run import import_recording
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import SEISMIC_QUANTITIES, Channel, SignalBlock, Stream
from groundtrace_codecs.writer import write_recording

if TYPE_CHECKING:
    from pathlib import Path

    from groundtrace.pipeline.config import PipelineConfig

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


def geophones(count: int = 1) -> Stream:
    channels = [Channel(f"G{i}", "ground_velocity", "m/s", "z") for i in range(1, count + 1)]
    return Stream("/geo", tuple(channels), 500.0)


def refused(pipeline: str | PipelineConfig, streams: list[Stream], site: Geometry | None) -> str:
    config = load_pipeline(pipeline) if isinstance(pipeline, str) else pipeline
    with pytest.raises(PipelineError) as error:
        refuse_unsuitable(config, streams, site, "r.mcap")
    return str(error.value)


def placed(count: int) -> Geometry:
    return Geometry(tuple(Sensor(f"G{i}", f"G{i}", float(i), 0.0) for i in range(1, count + 1)))


def test_a_pipeline_that_fits_no_quantity_is_refused_with_those_that_fit() -> None:
    text = refused(WALKER, [geophones()], None)
    assert text.startswith(
        "waist-steps needs acceleration or acceleration magnitude; r.mcap has 1 seismic channel, "
        "none with positions. Fitting: "
    )
    fitting = text.rpartition(": ")[2].removesuffix(".").split(", ")
    assert {"hammer-shots", "room-steps"} <= set(fitting)
    assert not {"waist-steps", "pedestrian", "foot-inertial", "signals"} & set(fitting)
    for name in fitting:
        refuse_unsuitable(load_pipeline(name), [geophones()], None, "r.mcap")


def test_a_pipeline_for_seismic_channels_says_how_many_and_whether_with_positions() -> None:
    text = refused("room-footsteps", [stream("waist")], None)
    assert text.startswith(
        "room-footsteps needs 3 or more seismic channels with positions; r.mcap has acceleration, "
        "angular velocity (worn: waist). Fitting: "
    )
    assert "waist-steps" in text
    assert "foot-inertial" not in text
    needs = "needs 3 or more seismic channels with positions; r.mcap has"
    assert f"{needs} 3 seismic channels, none" in refused("vehicle-tracks", [geophones(3)], None)
    assert f"{needs} 3 seismic channels, 2 with positions" in refused(
        "room-bearings", [geophones(3)], placed(2)
    )
    refuse_unsuitable(load_pipeline("room-footsteps"), [geophones(3)], placed(3), "r.mcap")
    refuse_unsuitable(load_pipeline("vehicle-passes"), [geophones()], placed(1), "r.mcap")


def test_a_pipeline_for_a_foot_is_refused_where_the_sensor_is_stated_to_be_elsewhere() -> None:
    text = refused("foot-inertial", [stream("waist")], None)
    assert text.startswith("foot-inertial needs a sensor on the foot; r.mcap has acceleration, ")
    for worn in ("foot", "left foot", ""):  # nobody stated it: it is guessed, and warned of
        refuse_unsuitable(load_pipeline("foot-inertial"), [stream(worn)], None, "r.mcap")


def test_a_pipeline_that_finds_something_or_wants_nothing_is_taken() -> None:
    refuse_unsuitable(WALKER, [geophones(), stream()], None, "r.mcap")
    with pytest.raises(PipelineError):  # it is the sensor of the walker that it finds
        refuse_unsuitable(WALKER, [geophones()], None, "r.mcap")
    refuse_unsuitable(load_pipeline("signals"), [geophones()], None, "r.mcap")


@pytest.mark.parametrize("name", sorted(named_pipelines()))
def test_a_shipped_pipeline_states_the_signals_that_its_stages_take(name: str) -> None:
    config = load_pipeline(name)
    kinds = [stage_named(stage.use) for stage in config.stage]
    needs = [need for kind in kinds for need in kind.takes if need.kind is SignalBlock]
    taken = {need.quantities for need in needs if need.required and need.quantities}
    least = {each for each in taken if not any(other < each for other in taken)}
    stated = {frozenset(each) for each in config.needs.signals}
    if config.needs.seismic_channels:
        stated.add(SEISMIC_QUANTITIES)
    assert stated == least


def test_what_a_pipeline_needs_is_kept_in_its_recipe_and_its_keys_are_checked() -> None:
    config = load_pipeline("vehicle-tracks")
    assert parse_pipeline(build_pipeline(config).recipe().encode(), "again").needs == config.needs
    with pytest.raises(PipelineError, match="found an unknown key; did you mean positions"):
        parse_pipeline(b'name = "x"\nstage = []\n[needs]\nposition = true\n', "x.toml")


def test_an_accelerometer_alone_does_not_suit_what_needs_a_gyroscope_too() -> None:
    force = stream().select([0, 1, 2])
    assert "needs angular velocity and acceleration; " in refused("heading", [force], None)
    # its steps are found
    refuse_unsuitable(load_pipeline("pedestrian"), [force], None, "r.mcap")


def test_topics_that_match_nothing_are_named() -> None:
    other = replace(WALKER, stage=(replace(WALKER.stage[0], topics=("/wrist*",)),))
    assert "acceleration magnitude on /wrist*; r.mcap has" in refused(other, [stream()], None)


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


def test_a_pipeline_for_a_foot_warns_where_a_guess_says_that_the_sensor_is_elsewhere(
    tmp_path: Path,
) -> None:
    def told(path: Path, pipeline: str) -> list[str]:
        with Recording.open(path) as opened:
            return [note.text for note in prepared(load_pipeline(pipeline), opened).notes]

    unstated = written(tmp_path / "unstated.mcap", body())
    (text,) = told(unstated, "foot-inertial")
    assert text.startswith("placement of /imu not stated: taken for waist or trunk (0.")
    assert "; foot-inertial is for a sensor on the foot: its results may be wrong; " in text
    (text,) = told(written(tmp_path / "short.mcap", body(8.0)), "foot-stances")
    assert ": too little walking on three axes of acceleration to guess it; foot-stances " in text
    assert told(written(tmp_path / "stated.mcap", body(), "left foot"), "foot-inertial") == []


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
