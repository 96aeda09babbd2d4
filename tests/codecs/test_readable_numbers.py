from __future__ import annotations

import math

import pytest

from groundtrace_codecs.events import readable

TOLD = (
    (4.933, "4.933"),
    (2760.4, "2760"),
    (12345.6, "12346"),
    (3e7, "30000000"),
    (0.0000456, "0.0000456"),
    (-1e-9, "-0.000000001"),
    (4.2e-23, "4.2 × 10^-23"),
    (2.5e12, "2.5 × 10^12"),
    (0.0, "0"),
    (math.inf, "inf"),
)


@pytest.mark.parametrize(("value", "text"), TOLD)
def test_numbers_that_people_read_have_no_exponent_where_decimals_will_do(
    value: float, text: str
) -> None:
    assert readable(value) == text


def test_digits_and_sign_are_as_asked() -> None:
    assert readable(0.00001234, 2, "+") == "+0.000012"
    assert readable(123456.0, 3) == "123456"
