"""How a worn sensor moves: from the waist's steps to trunk, thigh, wrist and foot.

The waist moves as a point above the feet with the accelerations of :mod:`.gait_shapes`. The trunk
follows it, damped, and turns against it. A phone in a trouser pocket hangs on the thigh and a
watch on the arm: both swing about hip and shoulder once a stride. A foot rests on the floor
between heel-off and contact of the other, and swings to its next place.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from .foot import foot_motion
from .gait import LATERAL
from .gait_shapes import Sway, add_bout
from .idling import add_idle

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from scipy.spatial.transform import Rotation

    from .gait import Plan
    from .person import Person
    from .walk_options import WalkOptions

    Array = NDArray[np.float64]

#: Of the waist's motion at the breastbone: acceleration ahead, left, up; yaw, pitch, roll.
_TRUNK = (np.array((0.75, 0.85, 0.97)), np.array((-0.7, 0.8, -0.5)))
#: From the joint to the sensor, ahead, left, up [m].
_THIGH_M = (0.06, -0.08, -0.22)
_ARM_M = (0.0, -0.03, -0.58)
#: Slower than this no gait repeats [Hz]; below it sums of steps would push the body off its path.
_SLOWEST_HZ = 0.15
_FILTERED = 30  # samples that are filtered or settled at least
#: Faster than this no part of the body turns about its joints [Hz].
_FASTEST_HZ = 8.0


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """A worn sensor's case in the world: acceleration (n, 3) [m/s2] and attitude (n,)."""

    acceleration: Array
    attitude: Rotation


def sensor_motion(
    options: WalkOptions, plan: Plan, who: Person, time_s: Array, rate_hz: float
) -> Motion:
    """Return how the body moves where the sensor is worn, at even ``time_s`` (n,) [s]."""
    from scipy.spatial.transform import Rotation

    if options.placement == "foot":
        return _foot(options, plan, who, time_s)
    heading = plan.heading(time_s)
    sway = _waist(options, plan, who, time_s, rate_hz)
    if options.placement == "trunk":
        sway = Sway(sway.acceleration * _TRUNK[0], sway.angle * _TRUNK[1])
    acceleration = _in_world(sway.acceleration, heading)
    if who.sensor.band_limited:
        _settle(acceleration, plan, time_s)
    if len(time_s) > 1:
        spacing_s = time_s[1] - time_s[0]
        acceleration[:, :2] += np.gradient(plan.velocity(time_s), spacing_s, axis=0)
    joint = np.zeros_like(sway.angle)
    if options.placement in ("phone", "wrist"):
        joint = _joint(plan, who, time_s, arm=options.placement == "wrist")
        joint = _filtered(joint, time_s, _FASTEST_HZ / 2, "lowpass")
    angle = sway.angle + joint
    angle[:, 0] += heading
    attitude = Rotation.from_euler("ZYX", angle)
    if options.placement in ("phone", "wrist"):
        lever = _ARM_M if options.placement == "wrist" else _THIGH_M
        acceleration += second_derivative(attitude.apply(lever), time_s)
    return Motion(acceleration, attitude)


def _waist(options: WalkOptions, plan: Plan, who: Person, time_s: Array, rate_hz: float) -> Sway:
    """Return the waist's motion against the path."""
    sway = Sway(np.zeros((len(time_s), 3)), np.zeros((len(time_s), 3)))
    for bout in plan.bouts:
        near = slice(*np.searchsorted(time_s, (bout.span_s[0] - 1, bout.span_s[1] + 1)))
        part = Sway(sway.acceleration[near], sway.angle[near])
        add_bout(part, bout, who.manner, time_s[near], rate_hz)
    if who.sensor.band_limited:
        sway = Sway(
            _filtered(sway.acceleration, time_s, _SLOWEST_HZ, "highpass"),
            _filtered(sway.angle, time_s, _FASTEST_HZ, "lowpass"),
        )
    add_idle(sway, plan, options.seed, time_s)
    return sway


def _filtered(values: Array, time_s: Array, corner_hz: float, kind: str) -> Array:
    """Return ``values`` (n, 3) through a filter that delays nothing."""
    from scipy.signal import butter, sosfiltfilt

    rate_hz = 1 / (time_s[1] - time_s[0]) if len(time_s) >= _FILTERED else 0.0
    if rate_hz <= 2 * corner_hz:
        return values
    sos = butter(1, corner_hz, kind, fs=rate_hz, output="sos")
    kept: Array = sosfiltfilt(sos, values, axis=0)
    return kept


def _in_world(sway: Array, heading: Array) -> Array:
    """Return an acceleration ahead, left, up along x, y, up, shape (n, 3)."""
    cos, sin = np.cos(heading), np.sin(heading)
    x = sway[:, 0] * cos - sway[:, 1] * sin
    return np.stack([x, sway[:, 0] * sin + sway[:, 1] * cos, sway[:, 2]], axis=1)


def _settle(acceleration: Array, plan: Plan, time_s: Array) -> None:
    """Correct ``acceleration`` (n, 3) so that no walk's sway leaves a speed or moves the body."""
    for bout in plan.bouts:
        first, last = np.searchsorted(time_s, (bout.span_s[0] - 0.3, bout.span_s[1] + 0.8))
        near = acceleration[first:last]
        part = np.linspace(0.0, 1.0, len(near))
        bump = part * (1 - part)
        basis = np.stack([bump, bump * (part - 0.5)], axis=1)
        # what is left at the end: speed, and place by the time left to move on
        remaining = np.stack([np.ones_like(part), 1 - part])
        if len(near) >= _FILTERED:
            near -= basis @ np.linalg.solve(remaining @ basis, remaining @ near)


def _joint(plan: Plan, who: Person, time_s: Array, *, arm: bool) -> Array:
    """Return yaw, pitch and roll of the right thigh or arm against the pelvis, (n, 3) [rad]."""
    angle = np.zeros((len(time_s), 3))
    for bout in plan.bouts:
        near = slice(*np.searchsorted(time_s, (bout.span_s[0] - 1, bout.span_s[1] + 1)))
        phase = bout.phase(time_s[near])
        if bout.kind == "backward":
            phase = 1 + who.manner.double_support - phase
        # Phase of the stride from the right foot's contact; the arm swings against its leg.
        stride = np.pi * (phase - (bout.first == "left") + arm)
        gain = who.swing * np.minimum(bout.envelope(time_s[near]), 1.3)
        if bout.kind in LATERAL:
            lead = 1.0 if bout.kind == "right" else -0.5
            angle[near, 2] -= gain * (0.06 if arm else 0.13) * lead * np.cos(stride)
        else:
            bend = np.cos(stride + 0.3) + 0.2 * np.cos(2 * stride - 1.0)
            angle[near, 1] -= gain * (0.3 * np.cos(stride) + 0.08 if arm else 0.33 * bend + 0.06)
    return angle


def _foot(options: WalkOptions, plan: Plan, who: Person, time_s: Array) -> Motion:
    """Return how the right foot moves; of idle time it only feels what shakes the floor."""
    from scipy.spatial.transform import Rotation

    steps = foot_motion(plan, who.manner, time_s)
    sway = Sway(np.zeros((len(time_s), 3)), np.zeros((len(time_s), 3)))
    rides = tuple(idle for idle in plan.idles if idle.activity == "ride")
    if rides:
        add_idle(sway, replace(plan, fidget_s=(), idles=rides), options.seed, time_s)
    acceleration = second_derivative(steps.place, time_s) + sway.acceleration
    return Motion(acceleration, Rotation.from_euler("ZYX", steps.angle + sway.angle))


def second_derivative(place: Array, time_s: Array) -> Array:
    """Return the second derivative of ``place`` (n, 3) at even times, 0 at the ends, (n, 3)."""
    derivative = np.zeros_like(place)
    if len(time_s) > 2:
        spacing_s = time_s[1] - time_s[0]
        derivative[1:-1] = np.diff(place, 2, axis=0) / spacing_s**2
    return derivative
