from __future__ import annotations

import math

import pytest

from groundtrace_codecs.errors import SchemaError
from groundtrace_codecs.signals import to_quantity, to_si


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
    with pytest.raises(SchemaError, match="expected a unit of pressure, one of Pa, hPa"):
        to_quantity("pressure", "deg/s")


def test_any_quantity_may_be_in_arbitrary_units() -> None:
    for quantity in ("magnetic_field", "acceleration", "pressure", "voltage"):
        assert to_quantity(quantity, "a.u.") == ("a.u.", 1.0)


@pytest.mark.parametrize(
    ("quantity", "unit", "near"),
    [
        ("acceleration", "m/ss", "m/s2"),
        ("angular_velocity", "degs/s", "deg/s"),
        ("magnetic_field", "Ut", "uT"),
        ("pressure", "hpa", "hPa"),
        ("ground_velocity", "mm/sec", "mm/s"),
    ],
)
def test_a_wrong_spelling_names_the_nearest_of_its_quantity(
    quantity: str, unit: str, near: str
) -> None:
    with pytest.raises(SchemaError, match=rf"found '{unit}'; did you mean {near}\?"):
        to_quantity(quantity, unit)


def test_an_unknown_quantity_is_refused() -> None:
    with pytest.raises(SchemaError, match=r"quantity: expected one of acceleration, .*'speed'"):
        to_quantity("speed", "m/s")
