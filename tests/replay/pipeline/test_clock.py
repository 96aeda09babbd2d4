"""The clock returns waits and never sleeps."""

from __future__ import annotations

import math
import time

import pytest

from groundtrace.pipeline.engine import Clock
from groundtrace_codecs.signals import NS_PER_S

T0 = 1_700_000_000 * NS_PER_S


def at(seconds: float) -> int:
    return T0 + round(seconds * NS_PER_S)


def test_the_first_time_asked_for_is_due_now():
    assert Clock(1.0).wait_s(at(0), 100.0) == 0.0


@pytest.mark.parametrize(("rate", "wait"), [(1.0, 3.0), (2.0, 1.5), (0.5, 6.0)])
def test_the_wait_is_recorded_time_over_rate(rate, wait):
    clock = Clock(rate)
    clock.wait_s(at(0), 100.0)
    assert clock.wait_s(at(3), 100.0) == pytest.approx(wait)
    assert clock.wait_s(at(3), 100.0 + wait / 3) == pytest.approx(wait * 2 / 3)


def test_what_is_late_is_due_at_once_and_the_delay_does_not_add_up():
    clock = Clock(1.0)
    clock.wait_s(at(0), 100.0)
    assert clock.wait_s(at(1), 105.0) == 0.0
    assert clock.wait_s(at(6), 105.0) == pytest.approx(1.0)


def test_rate_zero_never_waits():
    clock = Clock()
    assert clock.wait_s(at(0), 0.0) == clock.wait_s(at(1e6), 0.0) == 0.0


@pytest.mark.parametrize("rate", [-1.0, math.nan, math.inf])
def test_a_rate_that_is_none_is_refused(rate):
    with pytest.raises(ValueError, match="rate: expected a number >= 0, found"):
        Clock(rate)


def test_the_clock_never_sleeps(monkeypatch):
    monkeypatch.setattr(time, "sleep", lambda _: pytest.fail("slept"))
    clock = Clock(1.0)
    clock.wait_s(at(0), 0.0)
    assert clock.wait_s(at(1000), 0.0) == pytest.approx(1000.0)
