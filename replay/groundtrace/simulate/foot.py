"""The right foot: at rest on the floor, and in the air between two of its places."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .gait import LATERAL, smooth_step

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .gait import Bout, Plan
    from .gait_shapes import Manner

    Array = NDArray[np.float64]

_ASIDE_M = 0.09  # from the body's path to a foot
_LIFT_M = {"forward": 0.10, "backward": 0.08, "left": 0.06, "right": 0.06}
#: Pitch of the foot over a forward swing, from heel-off (0) to contact (1) [rad], heel up positive.
_SWING = (0.0, 0.28, 0.62, 0.9, 1.0)
_PITCH_RAD = (0.0, 0.85, 0.12, -0.30, -0.26)
_SLAP_S = 0.09  # from contact to the whole sole on the floor
_SHAKE_HZ, _SHAKE_S = 32.0, 0.018
_HEEL_OFF = 0.25  # before the toes leave the floor, in steps


@dataclass(frozen=True, slots=True, eq=False)
class FootMotion:
    """Place along x, y, up [m] and yaw, pitch, roll [rad], each of shape (n, 3)."""

    place: Array
    angle: Array


@dataclass(frozen=True, slots=True)
class _Swing:
    """From heel-off to contact [s], for a walk of one type, and how strong the contact is."""

    off_s: float
    contact_s: float
    bout: Bout
    strength: float


def foot_motion(plan: Plan, manner: Manner, time_s: Array) -> FootMotion:
    """Return the motion of the right foot at even ``time_s`` (n,) [s].

    The foot lands where the body will be half a step later, so it never slides on the floor.
    """
    place, angle = np.zeros((len(time_s), 3)), np.zeros((len(time_s), 3))
    heading = plan.heading(time_s)
    body = plan.track(time_s)

    def rest(moment_s: float) -> Array:
        """Return x, y and yaw of a foot under the body at ``moment_s``."""
        x, y = (np.interp(moment_s, time_s, np.ascontiguousarray(b)) for b in body.T)
        yaw = np.interp(moment_s, time_s, heading)
        return np.array((x + _ASIDE_M * np.sin(yaw), y - _ASIDE_M * np.cos(yaw), yaw))

    here = rest(0.0)
    begun = 0
    swings = _swings(plan, manner)
    for swing in swings:
        there = rest(swing.contact_s + swing.bout.step_s / 2)
        off, on = np.searchsorted(time_s, (swing.off_s, swing.contact_s))
        place[begun:off, :2], angle[begun:off, 0] = here[:2], here[2]
        part = (time_s[off:on] - swing.off_s) / (swing.contact_s - swing.off_s)
        moved = here + smooth_step(part)[:, None] * (there - here)
        place[off:on, :2], angle[off:on, 0] = moved[:, :2], moved[:, 2]
        place[off:on, 2] = _LIFT_M[swing.bout.kind] * 64 * (part * (1 - part)) ** 3
        _pitch(angle[:, 1], swing, time_s)
        here, begun = there, on
    place[begun:, :2], angle[begun:, 0] = here[:2], here[2]
    for swing in swings:
        _land(place, swing, manner, time_s)
    return FootMotion(place, angle)


def _swings(plan: Plan, manner: Manner) -> list[_Swing]:
    """Return the swings of the right foot, one before each of its contacts."""
    swings = []
    for bout in plan.bouts:
        contact_s = bout.contact_s.tolist()
        for index, moment_s in enumerate(contact_s):
            if bout.foot(index) != "right":
                continue
            other_s = contact_s[index - 1] if index else moment_s - 0.9 * bout.step_s
            off_s = other_s + (manner.double_support - _HEEL_OFF) * bout.step_s
            if bout.kind in LATERAL and index:
                off_s = other_s + 0.1 * bout.step_s
            swings.append(_Swing(off_s, moment_s, bout, float(bout.strength[index])))
    return swings


def _pitch(pitch: Array, swing: _Swing, time_s: Array) -> None:
    """Add the foot's pitch over a swing and until the sole is down again, to ``pitch`` (n,)."""
    from scipy.interpolate import CubicSpline

    if swing.bout.kind in LATERAL:
        near = slice(*np.searchsorted(time_s, (swing.off_s, swing.contact_s)))
        part = (time_s[near] - swing.off_s) / (swing.contact_s - swing.off_s)
        pitch[near] += 0.25 * 64 * (part * (1 - part)) ** 3
        return
    down = _SLAP_S / (swing.contact_s - swing.off_s)
    knots = np.array((*_SWING, 1 + down))
    angles = np.array((*_PITCH_RAD, 0.0))
    if swing.bout.kind == "backward":  # run in reverse: toes land first
        knots, angles = 1 + down - knots[::-1], angles[::-1] * 0.6
    curve = CubicSpline(knots, angles, bc_type="clamped")
    near = slice(*np.searchsorted(time_s, (swing.off_s, swing.contact_s + _SLAP_S)))
    pitch[near] += curve((time_s[near] - swing.off_s) / (swing.contact_s - swing.off_s))


def _land(place: Array, swing: _Swing, manner: Manner, time_s: Array) -> None:
    """Add to ``place`` (n, 3) how a contact shakes the foot, which leaves it where it was."""
    near = slice(*np.searchsorted(time_s, (swing.contact_s, swing.contact_s + 0.2)))
    late = (time_s[near] - swing.contact_s) / _SHAKE_S
    soft = 1.0 if swing.bout.kind == "forward" else 0.5
    blow = soft * manner.impact * swing.strength * late * np.exp(-late)
    turn = 2 * np.pi * _SHAKE_HZ
    shake = blow * np.sin(turn * _SHAKE_S * late) / turn**2
    place[near] += shake[:, None] * (-12.0, 4.0, 18.0)
