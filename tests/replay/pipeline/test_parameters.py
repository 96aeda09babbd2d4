"""Parameters: documented, checked, and refused in one line that says what is allowed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import pytest

from groundtrace.errors import PipelineError
from groundtrace.pipeline.parameters import build, describe, gate, measured, parse_value


@dataclass(frozen=True, slots=True)
class Settings:
    corner_hz: Annotated[float, measured("Hz", "A corner.", gt=0, le=100)] = 3.0
    count: Annotated[int, gate("1", "A count.", ge=1)] = 4
    shape: Annotated[Literal["sharp", "round"], measured("1", "A shape.")] = "sharp"
    strict: Annotated[bool, measured("1", "A switch.")] = False


def test_parameters_are_described_with_unit_part_bounds_and_default():
    corner, count, *_ = describe(Settings)
    assert (corner.name, corner.unit, corner.doc) == ("corner_hz", "Hz", "A corner.")
    assert (corner.part, corner.allowed, corner.default) == ("measure", "float > 0 and <= 100", 3.0)
    assert (count.part, count.allowed, count.default) == ("decide", "int >= 1", 4)


def test_a_parameter_without_a_description_is_refused():
    @dataclass(frozen=True)
    class Bare:
        corner_hz: float = 1.0

    with pytest.raises(PipelineError, match=r"^Bare\.corner_hz: expected a description"):
        describe(Bare)


def test_values_are_taken_and_the_rest_stays_as_it_is_by_default():
    built = build(Settings, {"corner_hz": 5, "shape": "round", "strict": True}, "stage")
    assert built == Settings(corner_hz=5.0, shape="round", strict=True)
    assert isinstance(built.corner_hz, float)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (
            {"cornr": 1.0},
            "steps.cornr: expected one of corner_hz, count, shape, strict, found an unknown key; "
            "did you mean corner_hz?",
        ),
        ({"corner_hz": "3"}, "steps.corner_hz: expected float > 0 and <= 100, found '3'"),
        ({"corner_hz": 0.0}, "steps.corner_hz: expected float > 0 and <= 100, found 0.0"),
        ({"corner_hz": 101}, "steps.corner_hz: expected float > 0 and <= 100, found 101"),
        ({"corner_hz": float("nan")}, "steps.corner_hz: expected float > 0 and <= 100, found nan"),
        ({"shape": "flat"}, "steps.shape: expected Literal['sharp', 'round'], found 'flat'"),
        ({"corner_hz": True}, "steps.corner_hz: expected float > 0 and <= 100, found True"),
        ({"count": 2.5}, "steps.count: expected int >= 1, found 2.5"),
        ({"count": 0}, "steps.count: expected int >= 1, found 0"),
        ({"strict": 1}, "steps.strict: expected bool, found 1"),
    ],
)
def test_a_wrong_value_is_refused_in_one_line(values, message):
    with pytest.raises(PipelineError) as caught:
        build(Settings, values, "steps")
    assert str(caught.value) == message


@dataclass(frozen=True, slots=True)
class Open:
    level: Annotated[float, gate("1", "A level.", ge=0)] = 1.0


def test_infinity_is_no_threshold():
    with pytest.raises(PipelineError) as caught:
        build(Open, {"level": float("inf")}, "steps")
    assert str(caught.value) == "steps.level: expected a finite number, found inf"


@dataclass(frozen=True, slots=True)
class Nothing:
    pass


def test_a_plugin_without_parameters_says_so():
    with pytest.raises(PipelineError, match=r"^s\.x: expected one of no parameter, found"):
        build(Nothing, {"x": 1}, "s")


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("0.6", 0.6),
        ("6", 6),
        ("-1e-3", -1e-3),
        ("true", True),
        ("[1, 2]", [1, 2]),
        ('"6"', "6"),
        ("sharp", "sharp"),
        ("", ""),
        ("a=b", "a=b"),
    ],
)
def test_a_setting_is_read_as_toml_or_else_as_text(text, value):
    assert parse_value(text) == value
    assert type(parse_value(text)) is type(value)
