"""How long a step is: from nothing, from the walker's height, or from how the body moved.

Sources: H. Weinberg, Using the ADXL202 in pedometer and personal navigation applications, Analog
Devices AN-602 (2002): the length goes with the fourth root of the swing of the vertical
acceleration. W. Zijlstra and A. L. Hof, Displacement of the pelvis during human walking, Gait &
Posture 6 (1997) 249: the body is an inverted pendulum on the leg, and what it rises tells the
length, times a factor, 1.25 there.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from groundtrace_codecs.signals import NS_PER_S

from ..later import Later

if TYPE_CHECKING:
    from . import step_kernels
    from .level_motion import Motion
    from .parameters import ReckoningParameters
else:
    step_kernels = Later("groundtrace.reckoning.step_kernels")

#: Vertical accelerations are averaged over this [s]: impacts say nothing of a step's length.
SMOOTH_S = 0.1
#: Signal on both sides of a step that serves its smoothing [ns].
MARGIN_NS = NS_PER_S // 20
#: Part of the height that the leg is (Winter, Biomechanics and motor control: 0.53).
LEG = 0.53


class StepShape(NamedTuple):
    """How the body moved up and down during a step.

    Attributes
    ----------
    swing
        Highest minus lowest vertical acceleration [m/s2].
    rise_m
        How far it rose and sank [m].
    """

    swing: float
    rise_m: float


def shape_of(motion: Motion, start_ns: int, stop_ns: int) -> StepShape:
    """Return the shape of a step in ``[start_ns, stop_ns)``.

    The body's height is taken to be after it as before it.
    """
    given = (motion.time_ns, motion.acceleration, start_ns, stop_ns)
    return StepShape(*step_kernels.shape(*given, MARGIN_NS, SMOOTH_S))


def step_length(shape: StepShape, kind: str, parameters: ReckoningParameters) -> float:
    """Return the length of a step [m].

    Parameters
    ----------
    shape
        How the body moved.
    kind
        Type of the step: ``backward``, ``left``, ``right``; anything else is one ahead.
    parameters
        Choose the model and hold its constants.
    """
    p = parameters
    by_kind = {"backward": p.backward, "left": p.sideways, "right": p.sideways}
    return _ahead(shape, p) * by_kind.get(kind, 1.0)


def _ahead(shape: StepShape, p: ReckoningParameters) -> float:
    if p.step_length == "fixed":
        return p.length_m
    if p.step_length == "calibrated":
        return p.calibrated_m / p.calibrated_steps
    if p.step_length == "height":
        return p.height_part * p.height_m
    if p.step_length == "weinberg":
        return p.weinberg * math.sqrt(math.sqrt(shape.swing))
    leg = LEG * p.height_m
    rise = min(shape.rise_m, leg)
    return p.pendulum * 2 * math.sqrt(2 * leg * rise - rise**2)
