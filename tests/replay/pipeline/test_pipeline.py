"""Pipelines: read, checked, changed by settings, printed as a recipe, and run as a chain."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from replay_blocks import START_NS, block_of, stream_of

from groundtrace.errors import PipelineError, PluginError
from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import (
    PipelineConfig,
    load_pipeline,
    named_pipelines,
    parse_pipeline,
    with_settings,
)
from groundtrace.pipeline.parameters import StageConfig
from groundtrace_codecs.events import CandidateBlock, Gap, Note, Pick, StageSpec, StepEvent
from groundtrace_codecs.signals import NS_PER_S

TEXT = """
name = "mine"
application = "shots"
[[stage]]
name = "picks"
use = "sta-lta"
topics = ["/a*"]
[stage.parameters]
ratio = 4
[[stage]]
use = "coincidence"
"""


def parsed(text: str = TEXT) -> PipelineConfig:
    return parse_pipeline(text.encode(), "mine.toml")


def test_a_pipeline_is_read():
    config = parsed()
    assert (config.name, config.application, config.description) == ("mine", "shots", "")
    assert config.stage[0] == StageConfig("sta-lta", "picks", ("/a*",), {"ratio": 4})
    assert [stage.key for stage in config.stage] == ["picks", "coincidence"]


def test_a_pipeline_without_stages_must_say_so_and_its_recipe_is_read_again() -> None:
    config = parse_pipeline(b'name = "signals"\nstage = []', "mine.toml")
    pipeline = build_pipeline(config)
    assert pipeline.stages == ()
    assert parse_pipeline(pipeline.recipe().encode(), "recipe") == config


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name = ", "mine.toml: expected TOML, found: "),
        ('name = "m"', "mine.toml: stage: expected at least one [[stage]], found none"),
        ('name = "m"\nstage = 3', "mine.toml: stage: expected [[stage]] tables, found 3"),
        (
            'name = "m"\nstages = 1',
            "mine.toml: stages: expected one of name, description, application, stage, "
            "placements, needs, found an",
        ),
        (
            'name = "m"\n[[stage]]\nuse = "dp"\n[[stage]]\nuse = "dp"\nparams = {}',
            "mine.toml: stage 2: params: expected one of use, name, topics, parameters, source, "
            "found an",
        ),
        (
            'name = "m"\n[[stage]]\nuse = "dp"\n[[stage]]\nuse = "zc"\nname = "dp"',
            "mine.toml: stage: expected stages of different names, found dp",
        ),
        (
            'name = "m"\napplication = "sea"\n[[stage]]\nuse = "dp"',
            "mine.toml: application: expected one of room, walker, vehicle, shots, found 'sea'",
        ),
        ('name = 3\n[[stage]]\nuse = "dp"', "mine.toml: expected a pipeline, found: Expected"),
        ('[[stage]]\nuse = "dp"', "mine.toml: expected a pipeline, found: Object missing"),
    ],
)
def test_a_wrong_pipeline_is_refused_in_one_line(text, message):
    with pytest.raises(PipelineError) as caught:
        parsed(text)
    assert str(caught.value).startswith(message)
    assert "\n" not in str(caught.value)


def test_bytes_that_are_no_text_are_refused():
    with pytest.raises(PipelineError, match=r"^x\.toml: expected TOML, found: 'utf-8'"):
        parse_pipeline(b"\xff", "x.toml")


def test_shipped_pipelines_are_found_by_name_and_files_by_path(tmp_path):
    assert {"room-footsteps", "waist-steps", "hammer-shots"} <= set(named_pipelines())
    for name in named_pipelines():
        assert load_pipeline(name).name == name
    path = tmp_path / "mine.toml"
    path.write_text(TEXT)
    assert load_pipeline(str(path)) == parsed()
    with pytest.raises(PipelineError, match=r"^none: expected a file or one of .*, found neither"):
        load_pipeline("none")


def test_settings_change_one_parameter_and_the_last_one_counts():
    config = with_settings(parsed(), ["picks.ratio=5", "picks.floor=1.5", "picks.ratio=6.0"])
    assert config.stage[0].parameters == {"ratio": 6.0, "floor": 1.5}
    assert parsed().stage[0].parameters == {"ratio": 4}
    dotted = PipelineConfig("m", stage=(StageConfig("dp", "a.b"),))
    assert with_settings(dotted, ["a.b.height=1"]).stage[0].parameters == {"height": 1}


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("picks.ratio", "--set: expected stage.param=value, found 'picks.ratio'"),
        ("ratio=1", "--set: expected stage.param=value, found 'ratio=1'"),
        ("picks.=1", "--set: expected stage.param=value, found 'picks.=1'"),
        (
            "pick.ratio=1",
            "--set: expected a stage of picks, coincidence, found 'pick' in 'pick.ratio=1'; "
            "did you mean picks?",
        ),
    ],
)
def test_a_setting_of_another_form_or_stage_is_refused(setting, message):
    with pytest.raises(PipelineError) as caught:
        with_settings(parsed(), [setting])
    assert str(caught.value) == message


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("picks.ratio=low", "picks.ratio: expected float >= 0, found 'low'"),
        ("picks.ratio=-1", "picks.ratio: expected float >= 0, found -1"),
        ("coincidence.min_channels=2.5", "coincidence.min_channels: expected int >= 1, found 2.5"),
    ],
)
def test_a_wrong_setting_is_refused_when_the_pipeline_is_built(setting, message):
    with pytest.raises(PipelineError) as caught:
        build_pipeline(with_settings(parsed(), [setting]))
    assert str(caught.value) == message


def test_an_unknown_plugin_is_refused():
    with pytest.raises(PluginError, match=r"^use: expected one of .*coincidence.*found 'dq'$"):
        build_pipeline(PipelineConfig("m", stage=(StageConfig("dq"),)))


def assert_round_trip(config: PipelineConfig) -> None:
    built = build_pipeline(config)
    again = build_pipeline(parse_pipeline(built.recipe().encode(), "recipe"))
    assert again.recipe() == built.recipe()
    for one, other in zip(built.stages, again.stages, strict=True):
        assert type(one) is type(other)
        for name in ("name", "plugin", "kind", "parameters", "topics"):
            assert getattr(one, name) == getattr(other, name)
    assert (again.config.name, again.config.description) == (config.name, config.description)
    assert again.config.application == config.application


@pytest.mark.parametrize("name", sorted(named_pipelines()))
def test_the_recipe_of_a_shipped_pipeline_builds_the_same_pipeline(name):
    assert_round_trip(load_pipeline(name))


TEXTS = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\x7f"), max_size=12)


@given(
    name=TEXTS,
    description=TEXTS,
    topics=st.lists(TEXTS, max_size=2),
    ratio=st.floats(0, allow_nan=False, allow_infinity=False),
    refractory_s=st.floats(0, 1e-4),
)
def test_the_recipe_of_any_pipeline_builds_the_same_pipeline(
    name, description, topics, ratio, refractory_s
):
    stage = StageConfig(
        "sta-lta", 'a "b"\\', tuple(topics), {"ratio": ratio, "refractory_s": refractory_s}
    )
    assert_round_trip(PipelineConfig(name, description, "room", (stage,)))


def test_the_recipe_states_every_parameter_with_unit_and_part():
    recipe = build_pipeline(with_settings(parsed(), ["coincidence.window_s=0.02"])).recipe()
    assert "window_s = 0.02  # s; measure\n" in recipe
    assert "min_channels = 4  # 1; decide\n" in recipe
    assert "ratio = 4.0  # 1; decide\n" in recipe


class Echo:
    """A stage that answers what it sees with a note."""

    def __init__(self, name: str, kinds: tuple[type, ...]) -> None:
        self.name, self.kinds = name, kinds

    def process(self, item):
        if isinstance(item, self.kinds):
            yield Note(0, f"{self.name}({getattr(item, 'text', 'block')})")

    def flush(self):
        yield Note(0, f"{self.name}.flush")


def test_every_stage_sees_the_item_and_what_the_stages_before_made_of_it():
    from groundtrace.pipeline.chain import Pipeline

    stream = stream_of()
    block = block_of(stream, 0, [0.0])
    stages = [Echo("a", (type(block),)), Echo("b", (type(block), Note)), Echo("c", (Note,))]
    chain = Pipeline(PipelineConfig("m"), stages, "")
    assert [e.text for e in chain.process(block)] == [
        "a(block)",
        "b(a(block))",
        "c(b(a(block)))",
        "c(a(block))",
        "b(block)",
        "c(b(block))",
    ]
    assert [e.text for e in chain.flush()] == [
        "a.flush",
        "b(a.flush)",
        "c(b(a.flush))",
        "c(a.flush)",
        "b.flush",
        "c(b.flush)",
        "c.flush",
    ]


def clicks(at_s: list[float], anchor_ns: int = START_NS, first: int = 0):
    """Two seconds of faint noise with loud clicks on four channels."""
    rng = np.random.default_rng(1)
    samples = rng.normal(0, 1e-3, (4000, 4))
    for time in at_s:
        samples[int(time * 2000) :][:40] += rng.normal(0, 1, (40, 4))
    block = block_of(stream_of(4, 2000.0), first, [0.0], anchor_ns)
    return type(block)(block.stream, anchor_ns, first, samples)


def test_a_room_pipeline_turns_arrivals_into_picks_and_picks_into_a_step():
    chain = build_pipeline(load_pipeline("room-footsteps"))
    events = [*chain.process(clicks([0.5, 1.2])), *chain.flush()]
    assert [e.stage for e in events if isinstance(e, StageSpec)] == [
        "picks",
        "steps",
        "arrivals",
    ]
    assert sum(isinstance(e, Pick) and e.stage == "picks" for e in events) == 8
    steps = [e for e in events if isinstance(e, StepEvent)]
    late = [(s.time_ns - START_NS) / NS_PER_S - t for s, t in zip(steps, (0.5, 1.2), strict=True)]
    assert np.abs(late).max() < 0.003
    assert [s.channels for s in steps] == [4, 4]


def test_a_clock_that_is_set_back_starts_the_refractory_time_and_the_groups_anew():
    chain = build_pipeline(load_pipeline("room-footsteps"))
    earlier = START_NS - 3600 * NS_PER_S
    events = list(chain.process(clicks([1.9])))
    events += chain.process(Gap("/s", earlier, earlier, "clock step", 0))
    events += chain.process(clicks([0.5, 0.9], earlier))
    events += chain.flush()
    steps = [e.time_ns for e in events if isinstance(e, StepEvent)]
    assert len(steps) == 3
    assert all(abs(t - earlier) < NS_PER_S for t in steps[1:])
    blocks = [e for e in events if isinstance(e, CandidateBlock) and e.spec.stage != "arrivals"]
    values = np.concatenate([e.gate_value for e in blocks])
    assert len(values)
