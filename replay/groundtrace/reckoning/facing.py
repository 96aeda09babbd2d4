"""Where a wearer looks: along an axis of the sensor that is named, or as the walk tells it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from groundtrace_codecs.signals import NS_PER_S

from ..heading.estimator import axis_of
from ..heading.walking_axis import STEEP, WalkingAxis, level_axis
from ..later import Later

if TYPE_CHECKING:
    from groundtrace_codecs.events import StepEvent

    from ..heading.rotation_kernels import Vector
    from ..heading.walking_axis import Ahead, Axis
    from . import step_kernels
    from .level_motion import Motion
else:
    step_kernels = Later("groundtrace.reckoning.step_kernels")

#: A step of another time than this says nothing of the walking axis [s].
SHORTEST_S, LONGEST_S = 0.25, 1.0
#: Weight of the steps before in the walking axis: a degree bends a whole walk, so that a sensor
#: that slips is followed more slowly here than for the type of a step.
KEEP = 0.99
#: So many steps tell the walking axis but for some tenths of a degree.
SETTLED = 60
#: Sign of the swing by the type of a step: back it is that ahead in a sensor turned half round.
SIGN = {"backward": -1.0, "left": 0.0, "right": 0.0}


@dataclass(slots=True)
class Facing:
    """Tells the direction a wearer looks in from the orientation of the sensor.

    Attributes
    ----------
    ahead
        The axis that looks ahead; ``walk``: what the swing of the steps tells against the first of
        the sensor's axes that is level enough.
    reference
        The axis whose direction is given; None before the first step where the walk tells.
    steps
        How many steps have told.
    turn_rad
        The way ahead against the reference, counter-clockwise [rad].
    """

    ahead: Ahead
    reference: Axis | None = None
    steps: int = 0
    turn_rad: float = 0.0
    _walking: WalkingAxis = field(default_factory=lambda: WalkingAxis(nominal=False, keep=KEEP))

    @property
    def settled(self) -> bool:
        """Whether what is told will hardly change."""
        return self.ahead != "walk" or self.steps >= SETTLED

    @property
    def news(self) -> str:
        """What a person should know when the walk has told the axis; empty at other steps."""
        if self.ahead != "walk" or self.steps != SETTLED:
            return ""
        angle = math.degrees(self.turn_rad)
        side = "left" if angle > 0 else "right"
        turned = f"{abs(angle):.0f} degrees to the {side} of the sensor's {self.reference}"
        return f"the walk tells that ahead is {turned}; steps before were gone again with that"

    def watch(self, step: StepEvent, interval_s: float, motion: Motion) -> None:
        """Take the next step; the motion must be known until a second after it."""
        if self.ahead != "walk":
            self.reference = self.ahead
            return
        reach_ns = round(min(interval_s, LONGEST_S) * NS_PER_S)
        times, about = motion.time_ns, (step.time_ns - reach_ns, step.time_ns + reach_ns)
        reference = self._refer(step_kernels.mean_up(times, motion.orientation, *about))
        self.steps += 1
        if SHORTEST_S <= interval_s <= LONGEST_S and (sign := SIGN.get(step.type, 1.0)):
            given = (times, motion.orientation, motion.acceleration, axis_of(reference))
            found, ahead, right = step_kernels.swing_about(*given, step.time_ns, reach_ns)
            if found:
                self._walking.add((sign * ahead, sign * right))
        self.turn_rad = -self._walking.angle_rad

    def heading(self, motion: Motion, start_ns: int, stop_ns: int) -> float:
        """Return the mean direction of the reference in the level axes in a time [rad]."""
        assert self.reference is not None  # a step was watched
        axis = axis_of(self.reference)
        return step_kernels.mean_heading(
            motion.time_ns, motion.orientation, axis, start_ns, stop_ns
        )

    def _refer(self, up: Vector) -> Axis:
        """Return the reference; another one, and all to be told anew, where it stands upright."""
        if self.reference is None or abs(up["xyz".index(self.reference[-1])]) > STEEP:
            self.reference, self.steps = level_axis(up), 0
            self._walking = WalkingAxis(nominal=False, keep=KEEP)
        return self.reference
