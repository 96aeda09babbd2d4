"""The clock returns waits and never sleeps."""

from __future__ import annotations

import math
import time

import pytest

from groundtrace.clock import Clock
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
    with pytest.raises(ValueError, match="rate: expected a number >= 0, found"):
        Clock(1.0).set_rate(rate, at(0), 0.0)


def test_a_pause_takes_its_own_time_out():
    clock = Clock(1.0)
    clock.wait_s(at(0), 100.0)
    clock.pause(101.0)
    assert clock.paused
    assert clock.wait_s(at(3), 150.0) == math.inf
    clock.pause(160.0)  # a second pause changes nothing
    clock.resume(201.0)
    assert not clock.paused
    assert clock.wait_s(at(3), 201.0) == pytest.approx(2.0)


def test_a_clock_paused_before_it_began_begins_when_it_resumes():
    clock = Clock(1.0)
    clock.pause(0.0)
    assert clock.wait_s(at(0), 5.0) == math.inf
    clock.resume(9.0)
    assert clock.wait_s(at(0), 9.0) == 0.0
    assert clock.wait_s(at(1), 9.0) == pytest.approx(1.0)


def test_resuming_a_running_clock_changes_nothing():
    clock = Clock(1.0)
    clock.wait_s(at(0), 100.0)
    clock.resume(110.0)
    assert clock.wait_s(at(12), 110.0) == pytest.approx(2.0)


@pytest.mark.parametrize("rate", [1.0, 0.0])
def test_a_step_lets_exactly_one_item_pass(rate):
    clock = Clock(rate)
    clock.wait_s(at(0), 100.0)
    clock.pause(100.5)
    clock.step()
    assert clock.wait_s(at(4), 101.0) == 0.0
    assert clock.wait_s(at(5), 101.0) == math.inf
    clock.step()
    clock.step()
    assert [clock.wait_s(at(s), 102.0) for s in (5, 6, 7)] == [0.0, 0.0, math.inf]


def test_after_steps_the_clock_goes_on_from_the_item_stepped_to():
    clock = Clock(1.0)
    clock.wait_s(at(0), 100.0)
    clock.pause(100.5)
    clock.step()
    clock.wait_s(at(4), 150.0)
    clock.resume(200.0)
    assert clock.wait_s(at(5), 200.0) == pytest.approx(1.0)


def test_a_step_of_a_running_clock_is_not_kept_for_the_next_pause():
    clock = Clock(1.0)
    clock.wait_s(at(0), 100.0)
    clock.step()
    clock.pause(100.5)
    assert clock.wait_s(at(4), 101.0) == math.inf


def test_steps_not_used_are_forgotten_on_resuming():
    clock = Clock(1.0)
    clock.pause(0.0)
    clock.step()
    clock.resume(1.0)
    clock.pause(2.0)
    assert clock.wait_s(at(0), 3.0) == math.inf


def test_a_new_rate_applies_from_where_the_clock_stands():
    clock = Clock(1.0)
    clock.wait_s(at(0), 100.0)
    clock.set_rate(4.0, at(2), 102.0)
    assert clock.wait_s(at(2), 102.0) == 0.0
    assert clock.wait_s(at(6), 102.0) == pytest.approx(1.0)


def test_a_seek_makes_a_time_due_now_forwards_and_backwards():
    clock = Clock(1.0)
    clock.wait_s(at(0), 100.0)
    for target in (500.0, -20.0):
        clock.seek(at(target), 101.0)
        assert clock.wait_s(at(target), 101.0) == 0.0
        assert clock.wait_s(at(target + 2), 101.0) == pytest.approx(2.0)


@pytest.mark.parametrize("change", ["seek", "set_rate"])
def test_what_is_changed_in_a_pause_holds_from_the_end_of_the_pause(change):
    clock = Clock(1.0)
    clock.wait_s(at(0), 100.0)
    clock.pause(101.0)
    if change == "seek":
        clock.seek(at(50), 130.0)
    else:
        clock.set_rate(1.0, at(50), 130.0)
    assert clock.wait_s(at(50), 131.0) == math.inf
    clock.resume(140.0)
    assert clock.wait_s(at(50), 140.0) == 0.0
    assert clock.wait_s(at(51), 140.0) == pytest.approx(1.0)


def test_a_loop_goes_back_to_its_start_at_its_end():
    clock = Clock(1.0, loop=(at(2), at(4)))
    assert clock.next_start_ns(at(3.999)) is None
    assert clock.next_start_ns(at(4)) == at(2)
    assert Clock(1.0).next_start_ns(at(1e6)) is None


def test_the_clock_never_sleeps(monkeypatch):
    monkeypatch.setattr(time, "sleep", lambda _: pytest.fail("slept"))
    clock = Clock(1.0)
    clock.wait_s(at(0), 0.0)
    assert clock.wait_s(at(1000), 0.0) == pytest.approx(1000.0)
