from __future__ import annotations

import math

import pytest

from groundtrace_codecs.errors import SchemaError
from groundtrace_codecs.units import to_quantity, to_si


@pytest.mark.parametrize(
    ("unit", "si", "factor"),
    [
        ("g", "m/s2", 9.80665),
        ("deg/s", "rad/s", math.pi / 180),
        ("uT", "T", 1e-6),
        ("nT", "T", 1e-9),
        ("gauss", "T", 1e-4),
        ("hPa", "Pa", 100.0),
        ("mbar", "Pa", 100.0),
        ("mm/s", "m/s", 1e-3),
        ("mV", "V", 1e-3),
        ("ms", "s", 1e-3),
        ("degC", "degC", 1.0),
        ("count", "count", 1.0),
        ("1", "1", 1.0),
        ("m/s^2", "m/s2", 1.0),
        ("°/s", "rad/s", math.pi / 180),
    ],
)
def test_a_unit_becomes_its_si_unit(unit: str, si: str, factor: float) -> None:
    assert to_si(unit)[0] == si
    assert to_si(unit)[1] == pytest.approx(factor, rel=1e-15)


def test_an_unknown_unit_is_refused_with_the_known_ones() -> None:
    with pytest.raises(SchemaError, match=r"unit: expected one of m/s2, .*hPa.*, found 'furlong'"):
        to_si("furlong")


def test_a_quantity_takes_its_unit_or_counts() -> None:
    assert to_quantity("acceleration", "g") == ("m/s2", 9.80665)
    assert to_quantity("acceleration", "count") == ("count", 1.0)


def test_positions_on_the_globe_stay_in_degrees() -> None:
    assert to_quantity("latitude", "deg") == ("deg", 1.0)
    assert to_quantity("latitude", "rad")[1] == pytest.approx(180 / math.pi)


def test_a_unit_of_something_else_is_refused() -> None:
    with pytest.raises(SchemaError, match=r"expected a unit of pressure \(Pa\) or count"):
        to_quantity("pressure", "deg/s")


def test_an_unknown_quantity_is_refused() -> None:
    with pytest.raises(SchemaError, match=r"quantity: expected one of acceleration, .*'speed'"):
        to_quantity("speed", "m/s")
