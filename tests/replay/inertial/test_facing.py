"""Where a wearer looks, as the steps of a level sensor tell it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from groundtrace.inertial.body_motion import LevelFrameMotion
from groundtrace.inertial.steps import SETTLED, BodyHeadingOffset
from groundtrace_codecs.events import StepEvent
from groundtrace_codecs.signals import NS_PER_S

if TYPE_CHECKING:
    from numpy.typing import NDArray

STEP_S, RATE_HZ = 0.5, 100.0


class Walker:
    """A walk to the east, felt by a sensor whose axes are turned against the level ones."""

    def __init__(self, sensor: Rotation, lead: float = 0.2) -> None:
        self.quaternion: NDArray[np.float64] = sensor.as_quat()[[3, 0, 1, 2]]
        self.lead = lead

    def between(self, start_ns: int, stop_ns: int) -> LevelFrameMotion:
        times = np.arange(start_ns, stop_ns, round(NS_PER_S / RATE_HZ))
        turn = 2 * np.pi * times / NS_PER_S / STEP_S
        zero = np.zeros(len(times))
        ahead = np.cos(turn + 2 * np.pi * self.lead)
        felt = np.stack([ahead, 0.5 * np.sin(turn / 2), 2 * np.cos(turn)], axis=1)
        return LevelFrameMotion(
            times, np.tile(self.quaternion, (len(times), 1)), felt, felt, zero, zero
        )


def told(walker: Walker, facing: BodyHeadingOffset, count: int = 20, kind: str = "") -> float:
    """Direction that a wearer is said to look in after some steps [degrees]."""
    for k in range(10, 10 + count):
        time_ns = round(k * STEP_S * NS_PER_S)
        step = StepEvent(time_ns, "step", "", "/acc", "steps", 1.0, type=kind)
        facing.watch(step, STEP_S, walker.between(time_ns - NS_PER_S, time_ns + NS_PER_S))
    heading = facing.heading(walker.between(0, NS_PER_S), 0, NS_PER_S) + facing.turn_rad
    return (math.degrees(heading) + 180) % 360 - 180


@pytest.mark.parametrize("yaw_deg", [0.0, 90.0, 180.0, -130.0])
@pytest.mark.parametrize("roll_deg", [0.0, 90.0])
def test_the_walk_tells_the_way_however_the_sensor_is_turned(
    yaw_deg: float, roll_deg: float
) -> None:
    sensor = Rotation.from_euler("ZX", [yaw_deg, roll_deg], degrees=True)
    assert told(Walker(sensor), BodyHeadingOffset("walk")) == pytest.approx(0, abs=5)


def test_an_axis_that_stands_upright_is_no_reference() -> None:
    sensor = Rotation.from_euler("ZY", [40.0, -90.0], degrees=True)
    facing = BodyHeadingOffset("walk")
    assert told(Walker(sensor), facing) == pytest.approx(0, abs=5)
    assert facing.reference == "y"


def test_a_sensor_put_on_another_way_is_told_anew() -> None:
    facing = BodyHeadingOffset("walk")
    told(Walker(Rotation.from_euler("Z", 40.0, degrees=True)), facing, SETTLED)
    assert facing.settled
    other = Walker(Rotation.from_euler("ZY", [40.0, -90.0], degrees=True))
    assert told(other, facing) == pytest.approx(0, abs=5)
    assert not facing.settled


def test_steps_known_to_go_back_do_not_turn_the_wearer_round() -> None:
    back = Walker(Rotation.identity(), lead=-0.2)
    assert abs(told(back, BodyHeadingOffset("walk"), 200)) == pytest.approx(180, abs=5)
    assert told(back, BodyHeadingOffset("walk"), 200, "backward") == pytest.approx(0, abs=5)


def test_a_named_axis_is_settled_from_the_first_step() -> None:
    facing = BodyHeadingOffset("-y")
    sensor = Walker(Rotation.from_euler("Z", 90.0, degrees=True))
    assert told(sensor, facing, 1) == pytest.approx(0, abs=1e-9)
    assert facing.settled
    assert facing.news == ""


def test_what_was_told_is_news_once() -> None:
    facing, walker = BodyHeadingOffset("walk"), Walker(Rotation.from_euler("Z", 90.0, degrees=True))
    told(walker, facing, SETTLED)
    assert "90 degrees to the right of the sensor's x" in facing.news
    told(walker, facing, 1)
    assert facing.news == ""
