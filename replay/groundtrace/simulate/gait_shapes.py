"""How the waist moves within a step: forward, backward and to the side.

Forward, the order is the one described for sensors at the lower back by Zijlstra and Hof (Gait &
Posture 18, 2003) and shown by the contacts of instrumented recordings:

- up: twice a stride the body falls onto the next foot. The vertical acceleration passes its mean
  going up about when that foot touches the floor (initial contact) and peaks about 0.1 s later,
  when the leg has taken the load; it is lowest while the body vaults over the stance leg.
- forward: pushed off just before a contact, braked just after it.
- sideways: once a stride, towards the middle from each stance leg.
- the pelvis turns forward with the swinging leg and rolls once a stride, nods once a step.
- each contact shakes the waist for some tens of milliseconds.

Backward walking is, to a good approximation, forward walking run in reverse (Thorstensson, Acta
Physiol Scand 126, 1986; Winter, Pluck and Yang, J Motor Behav 21, 1989). Accelerations keep their
sign under that, so the forward axis peaks after the vertical one where it came before; a foot
lands, toes first and softly, where it took off forward.

A side stride has two contacts: the stance leg pushes, the lead foot lands wide and brakes, the
trail foot closes. The body sinks onto each foot, deeper onto the lead foot.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .gait import LATERAL

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .gait import Bout, StepType

    Array = NDArray[np.float64]

#: Frequency and decay of a contact's shaking [Hz, s], and its amplitude ahead, left, up [m/s2].
_SHAKE = {
    "forward": (17.0, 0.045, (-1.3, 0.6, 2.0)),
    "backward": (12.0, 0.05, (0.35, 0.3, 0.7)),
    "left": (14.0, 0.045, (0.1, -0.5, 0.9)),
    "right": (14.0, 0.045, (0.1, 0.5, 0.9)),
}
_TRAIL_SHAKE = 0.5


@dataclass(frozen=True, slots=True)
class Manner:
    """How one person walks, relative to the mean.

    Attributes
    ----------
    ahead, aside, up
        Gains of the accelerations along the three axes.
    lag
        By how much the forward axis comes late against the vertical, in steps.
    hump
        Gain of the second harmonic, which makes two humps of a step.
    impact
        Gain of the contacts' shaking: shoe and floor.
    turning
        Gain of the pelvis's rotations.
    lean_rad
        Forward lean of an upright walker.
    double_support
        From a contact until the other foot leaves the floor, in steps.
    asymmetry
        By how much left steps are stronger than right ones.
    rock
        Phase of what a side stride does ahead [rad].
    """

    ahead: float = 1.0
    aside: float = 1.0
    up: float = 1.0
    lag: float = 0.0
    hump: float = 1.0
    impact: float = 1.0
    turning: float = 1.0
    lean_rad: float = 0.05
    double_support: float = 0.22
    asymmetry: float = 0.0
    rock: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Sway:
    """Motion against the path: acceleration ahead, left, up [m/s2]; yaw, pitch, roll [rad].

    Both have the shape (n, 3); pitch is positive leaning forward, roll to the right.
    """

    acceleration: Array
    angle: Array


def add_bout(sway: Sway, bout: Bout, manner: Manner, time_s: Array, rate_hz: float) -> None:
    """Add a walk's accelerations and rotations to ``sway``, given at ``time_s`` (n,).

    ``rate_hz`` is the rate at which the sensor samples: its own low-pass lets less of the shaking
    through where that is low.
    """
    phase = bout.phase(time_s)
    strength = bout.envelope(time_s)
    left = 1.0 if bout.first == "left" else -1.0
    if bout.kind in LATERAL:
        _side(sway, phase, strength, manner, 1.0 if bout.kind == "left" else -1.0)
    elif bout.kind == "backward":
        _straight(sway, 1 + manner.double_support - phase, strength, manner, left)
    else:
        _straight(sway, phase, strength, manner, left)
    _shake(sway, bout, manner, time_s, rate_hz)


def _straight(sway: Sway, phase: Array, strength: Array, manner: Manner, left: float) -> None:
    """Add forward steps; ``left`` is 1 where even contacts are left feet, -1 where right."""
    turn = 2 * np.pi * phase
    # Half a turn of the stride per step, its sine positive on the left leg.
    stride = np.pi * phase
    late = turn - 2 * np.pi * manner.lag
    up = np.sin(turn + 0.5) + 0.45 * manner.hump * np.sin(2 * turn - 0.6)
    forward = np.cos(late + 0.35) + 0.45 * manner.hump * np.cos(2 * late + 0.9)
    aside = -left * (np.sin(stride) + 0.35 * np.sin(3 * stride + 0.3))
    rolling = strength * manner.turning
    sway.acceleration[:, 0] += 1.1 * manner.ahead * strength * forward
    sway.acceleration[:, 1] += 1.0 * manner.aside * strength * aside
    sway.acceleration[:, 2] += 2.3 * manner.up * strength**2 * up
    sway.angle[:, 0] -= 0.07 * left * rolling * np.cos(stride)
    sway.angle[:, 1] += 0.025 * rolling * np.cos(turn - 0.6) + manner.lean_rad * strength
    sway.angle[:, 2] += 0.04 * left * rolling * np.sin(stride + 0.4)


def _side(sway: Sway, phase: Array, strength: Array, manner: Manner, left: float) -> None:
    """Add side steps; even contacts are the lead foot's, ``left`` is 1 to the left, -1 else."""
    stride = np.pi * phase
    push = _lobe(phase, -0.45, 1.6) - 0.15 * _lobe(phase, 1.1, 6.0)
    brake = 1.15 * _lobe(phase, 0.25, 2.6)
    up = _lobe(phase, 0.18, 3.0) + 0.55 * _lobe(phase, 1.2, 4.0)
    rolling = strength * manner.turning
    sway.acceleration[:, 0] += manner.ahead * strength * 0.25 * np.cos(stride + manner.rock)
    sway.acceleration[:, 1] += 1.9 * manner.aside * left * strength * (push - brake)
    sway.acceleration[:, 2] += 1.7 * manner.up * strength**2 * up
    sway.angle[:, 0] += 0.03 * left * rolling * np.sin(stride + manner.rock)
    sway.angle[:, 1] += 0.015 * rolling * np.cos(2 * stride) + 0.3 * manner.lean_rad * strength
    sway.angle[:, 2] -= 0.06 * left * rolling * np.cos(stride + 0.4)


def _lobe(phase: Array, middle: float, narrow: float) -> Array:
    """Return a smooth lobe of height 1, once in two steps, without its mean, shape (n,)."""
    from scipy.special import i0e

    lobe: Array = np.exp(narrow * (np.cos(np.pi * (phase - middle)) - 1)) - i0e(narrow)
    return lobe


def _shake(sway: Sway, bout: Bout, manner: Manner, time_s: Array, rate_hz: float) -> None:
    """Add what each contact shakes."""
    hz, decay_s, amplitude = _SHAKE[bout.kind]
    passed = manner.impact / (1 + (hz / (0.4 * rate_hz)) ** 4)
    contacts = zip(bout.contact_s, bout.strength, strict=True)
    for index, (contact_s, strong) in enumerate(contacts):
        trail = _TRAIL_SHAKE if bout.kind in LATERAL and index % 2 else 1.0
        near = slice(*np.searchsorted(time_s, (contact_s, contact_s + 0.3)))
        late = time_s[near] - contact_s
        shake = passed * trail * strong * np.sin(2 * np.pi * hz * late) * np.exp(-late / decay_s)
        sway.acceleration[near] += shake[:, None] * amplitude


def step_asymmetry(kind: StepType, first: str, count: int, manner: Manner) -> Array:
    """Return by how much each contact of a walk is stronger than the mean, shape (count,)."""
    if kind in LATERAL:
        return np.ones(count)
    sign = 1.0 if first == "left" else -1.0
    return 1 + sign * manner.asymmetry * np.where(np.arange(count) % 2 == 0, 1.0, -1.0)
