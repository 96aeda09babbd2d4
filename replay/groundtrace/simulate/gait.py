"""A pedestrian: when the feet touch the floor, where the body goes, and how a worn sensor moves.

The waist moves as a point above the feet with the accelerations of its gait. The trunk follows it,
damped, and turns against it. A phone in a trouser pocket hangs on the thigh and a watch on the arm:
both swing about hip and shoulder once a stride. A foot rests on the floor between heel-off and
contact of the other, and swings to its next place.

How the waist moves within a step. Forward, the order is the one described for sensors at the lower
back by Zijlstra and Hof (Gait & Posture 18, 2003) and shown by the contacts of instrumented
recordings:

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

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from ..errors import SimulationError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray
    from scipy.spatial.transform import Rotation

    Array = NDArray[np.float64]

StepType = Literal["forward", "backward", "left", "right"]
Foot = Literal["left", "right"]
Activity = Literal["sit", "reach", "handle", "ride"]

#: Types of side steps: a lead and a trail foot make one step.
LATERAL = frozenset({"left", "right"})
#: Where a step goes against where the body faces [rad], counter-clockwise. Source: definition.
COURSE_RAD: dict[StepType, float] = {
    "forward": 0.0,
    "backward": np.pi,
    "left": np.pi / 2,
    "right": -np.pi / 2,
}

#: Length of the bundled walk's cycle [s]. Chosen by judgement: two walks at different paces, and a
#: pause.
CYCLE_S = 60.0
#: Walks of a cycle: start, end, mean step time, step length, [s, s, s, m]. Standing lies between.
#: Chosen by judgement: a brisk and a slow walk.
_WALKS = ((5.0, 34.0, 0.54, 0.70), (39.0, 53.0, 0.66, 0.55))
#: Start and length of the left turn by 90 degrees, within the first walk [s]. Chosen by judgement:
#: four steps.
_TURN = (25.0, 2.4)
#: The pause in which the person fidgets [s]. Chosen by judgement: between the walks, nearly all of
#: the pause.
_FIDGET = (34.9, 38.4)


@dataclass(frozen=True, slots=True)
class Bout:
    """One walk without a stop.

    Attributes
    ----------
    contact_s
        Initial contacts, shape (n,) [s].
    strength
        How vigorous each step is, 1 = the mean of comfortable walking, shape (n,).
    speed_mps
        Mean speed [m/s].
    kind
        Type of all its steps. Of side steps even contacts are the lead foot's, odd ones the trail
        foot's.
    first
        Foot of the first contact.
    """

    contact_s: NDArray[np.float64]
    strength: NDArray[np.float64]
    speed_mps: float
    kind: StepType = "forward"
    first: Foot = "left"

    @property
    def step_s(self) -> float:
        """Mean time between contacts [s]."""
        return float(np.mean(np.diff(self.contact_s)))

    @property
    def span_s(self) -> tuple[float, float]:
        """The walk, from half a step before the first contact to half a step after the last."""
        half = self.step_s / 2
        return float(self.contact_s[0] - half), float(self.contact_s[-1] + half)

    def foot(self, index: int) -> Foot:
        """Return which foot makes contact ``index``."""
        other: Foot = "right" if self.first == "left" else "left"
        return other if index % 2 else self.first

    def phase(self, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the phase in steps, k at contact k, running on evenly outside, shape (n,)."""
        interpolated = np.interp(time_s, self.contact_s, np.arange(len(self.contact_s)))
        before = np.minimum(time_s - self.contact_s[0], 0) / self.step_s
        after = np.maximum(time_s - self.contact_s[-1], 0) / self.step_s
        phase: NDArray[np.float64] = interpolated + before + after
        return phase

    def envelope(self, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the strength over time: grows in half a step, dies out in one, shape (n,)."""
        knots = np.concatenate(([self.span_s[0]], self.contact_s, [self.contact_s[-1] + 0.55]))
        envelope: NDArray[np.float64] = np.interp(
            time_s, knots, np.concatenate(([0.0], self.strength, [0.0]))
        )
        return envelope

    def ground_speed(self, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the body's speed, from rest to rest within about a step [m/s], shape (n,)."""
        start_s, end_s = self.span_s
        rise = smooth_step((time_s - start_s) / (1.5 * self.step_s))
        fall = smooth_step((end_s - time_s) / (1.5 * self.step_s))
        return self.speed_mps * rise * fall


@dataclass(frozen=True, slots=True)
class Turn:
    """A smooth turn: start and length [s], and its angle [rad], positive to the left."""

    start_s: float
    length_s: float
    angle_rad: float


@dataclass(frozen=True, slots=True)
class Idle:
    """Something a person does without walking, over ``[start_s, end_s)`` [s]."""

    start_s: float
    end_s: float
    activity: Activity


@dataclass(frozen=True, slots=True)
class Plan:
    """All walks, turns and pauses of a recording.

    Attributes
    ----------
    bouts
        Walks, in order.
    turns
        Turns while walking.
    fidget_s
        Spans of fidgeting while standing [s].
    idles
        What else is done in pauses.
    """

    bouts: tuple[Bout, ...]
    turns: tuple[Turn, ...]
    fidget_s: tuple[tuple[float, float], ...] = ()
    idles: tuple[Idle, ...] = ()

    def heading(self, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return where the body faces [rad], counter-clockwise from x, at ascending times (n,)."""
        heading = np.zeros_like(time_s)
        for turn in self.turns:
            begun, done = np.searchsorted(time_s, (turn.start_s, turn.start_s + turn.length_s))
            part = (time_s[begun:done] - turn.start_s) / turn.length_s
            heading[begun:done] += turn.angle_rad * smooth_step(part)
            heading[done:] += turn.angle_rad
        return heading

    def velocity(self, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the body's velocity along x and y [m/s] at ascending times, shape (n, 2)."""
        heading = self.heading(time_s)
        velocity = np.zeros((len(time_s), 2))
        for bout in self.bouts:
            near = slice(*np.searchsorted(time_s, bout.span_s))
            course = heading[near] + COURSE_RAD[bout.kind]
            ahead = np.stack([np.cos(course), np.sin(course)], axis=1)
            velocity[near] += bout.ground_speed(time_s[near])[:, None] * ahead
        return velocity

    def track(self, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the body's place along x and y [m] at even times from 0, shape (n, 2)."""
        rate_hz = 1 / (time_s[1] - time_s[0]) if len(time_s) > 1 else 1.0
        track: NDArray[np.float64] = np.cumsum(self.velocity(time_s), axis=0) / rate_hz
        return track

    def progress(self, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return how far forward steps have come along the path [m] at even times, shape (n,)."""
        forward = tuple(bout for bout in self.bouts if bout.kind == "forward")
        speed = np.hypot(*replace(self, bouts=forward).velocity(time_s).T)
        rate_hz = 1 / (time_s[1] - time_s[0]) if len(time_s) > 1 else 1.0
        along: NDArray[np.float64] = np.cumsum(speed) / rate_hz
        return along


def plan(duration_s: float, rng: np.random.Generator) -> Plan:
    """Draw a plan: cycles of a minute, cut where the recording ends.

    Stand 5 s, walk, turn left after 20 s, walk on, pause and fidget 5 s, walk slower, stand 7 s.
    """
    bouts, turns, fidgets = [], [], []
    for start_s in np.arange(0.0, duration_s, CYCLE_S).tolist():
        for begin, end, step_s, length_m in _WALKS:
            bout = _bout(start_s + begin, start_s + end, step_s, length_m, rng)
            count = int(np.count_nonzero(bout.contact_s < duration_s - 1.0))
            if count >= 2:
                bouts.append(Bout(bout.contact_s[:count], bout.strength[:count], bout.speed_mps))
        turns.append(start_s + _TURN[0])
        fidgets.append((start_s + _FIDGET[0], start_s + _FIDGET[1]))
    return Plan(
        bouts=tuple(bouts),
        turns=tuple(Turn(t, _TURN[1], np.pi / 2) for t in turns if t + _TURN[1] < duration_s - 1.0),
        fidget_s=tuple(f for f in fidgets if f[1] < duration_s),
    )


def _bout(
    begin_s: float, end_s: float, step_s: float, length_m: float, rng: np.random.Generator
) -> Bout:
    """Draw a walk: gaps vary by 2.5 % from step to step, strengths by 8 %, the ends are gentle."""
    count = int((end_s - begin_s) / step_s)
    gaps = step_s * (1 + 0.025 * rng.standard_normal(count))
    contact_s = np.round(begin_s + np.cumsum(gaps), 6)
    strength = (length_m / 0.70) * (1 + 0.08 * rng.standard_normal(count))
    strength[[0, -1]] *= 0.7
    return Bout(contact_s, strength, length_m / step_s)


def smooth_step(part: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return 0 below 0, 1 above 1, and between them a rise that starts and ends flat."""
    x = np.clip(part, 0.0, 1.0)
    return x**3 * (x * (6 * x - 15) + 10)


#: Frequency and decay of a contact's shaking [Hz, s], and its amplitude ahead, left, up [m/s2].
#: Chosen by judgement: some tens of milliseconds; hard forward, soft backward and aside.
_SHAKE = {
    "forward": (17.0, 0.045, (-1.3, 0.6, 2.0)),
    "backward": (12.0, 0.05, (0.35, 0.3, 0.7)),
    "left": (14.0, 0.045, (0.1, -0.5, 0.9)),
    "right": (14.0, 0.045, (0.1, 0.5, 0.9)),
}
#: Part of it where a trail foot closes. Chosen by judgement: that foot bears little.
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


#: Chosen by judgement: usual chairs.
_SEAT_M = 0.42  # a seat is this much lower than a standing pelvis


def add_idle(sway: Sway, plan: Plan, seed: int, time_s: Array) -> None:
    """Add what a person does who stands: breathe and sway, shift the weight, look round, tap."""
    rng = np.random.default_rng([seed, 2])
    for hz in (0.25, 0.6, 1.1):
        swing = np.sin(2 * np.pi * (hz * time_s[:, None] + rng.uniform(0, 1, 3)))
        sway.acceleration[:] += 0.012 * swing
        sway.angle[:] += 0.004 / (1 + hz) * np.roll(swing, 1, axis=1)
    for start_s, end_s in plan.fidget_s:
        near = slice(*np.searchsorted(time_s, (start_s, end_s)))
        for middle_s in rng.uniform(start_s + 0.4, end_s - 0.4, 5):
            half_s = rng.uniform(0.25, 0.4)
            bump = np.clip(1 - ((time_s[near] - middle_s) / half_s) ** 2, 0, None) ** 2
            sway.acceleration[near] += bump[:, None] * rng.normal(0, (0.5, 0.7, 0.5))
            sway.angle[near] += bump[:, None] * rng.normal(0, (0.12, 0.04, 0.05))
        late = np.clip(time_s[near] - rng.uniform(start_s + 0.4, end_s - 0.4), 0, None)
        sway.acceleration[near, 2] += 200 * late * np.exp(-late / 0.02)
    for index, idle in enumerate(plan.idles):
        near = slice(*np.searchsorted(time_s, (idle.start_s, idle.end_s)))
        moves = {"sit": _sit, "reach": _reach, "handle": _handle, "ride": _ride}[idle.activity]
        moved, angle = moves(time_s[near], idle, np.random.default_rng([seed, 6, index]))
        sway.acceleration[near] += moved
        sway.angle[near] += angle


def _sit(time_s: Array, idle: Idle, rng: np.random.Generator) -> tuple[Array, Array]:
    """Sit down and stand up again: lean forward, sink, land, lean back; and the way back."""
    moved, angle = np.zeros((len(time_s), 3)), np.zeros((len(time_s), 3))
    down_s, up_s = rng.uniform(1.2, 1.8), rng.uniform(1.2, 1.8)
    for start_s, length_s, sign in (
        (idle.start_s, down_s, -1.0),
        (idle.end_s - up_s, up_s, 1.0),
    ):
        part = (time_s - start_s) / length_s
        # second derivative of the smooth step: the pelvis goes down, and back where one sits
        curve = np.where((part > 0) & (part < 1), 60 * part * (1 - part) * (1 - 2 * part), 0.0)
        moved[:, 2] += sign * _SEAT_M / length_s**2 * curve
        moved[:, 0] += sign * 0.25 / length_s**2 * curve
        angle[:, 1] += 0.5 * _bump(part)
    angle[:, 1] -= 0.15 * smooth_step((time_s - idle.start_s) / down_s)
    angle[:, 1] += 0.15 * smooth_step((time_s - idle.end_s + up_s) / up_s)
    landed = np.clip(time_s - idle.start_s - down_s, 0, None)
    moved[:, 2] += 6.0 * np.sin(2 * np.pi * 9.0 * landed) * np.exp(-landed / 0.06)
    return moved, angle


def _reach(time_s: Array, idle: Idle, rng: np.random.Generator) -> tuple[Array, Array]:
    """Reach for things: turn and bend for a second or two."""
    moved, angle = np.zeros((len(time_s), 3)), np.zeros((len(time_s), 3))
    for _ in range(int(rng.integers(1, 4))):
        length_s = min(float(rng.uniform(1.0, 2.0)), idle.end_s - idle.start_s)
        start_s = rng.uniform(idle.start_s, idle.end_s - length_s)
        part = (time_s - start_s) / length_s
        angle += _bump(part)[:, None] * rng.normal(0, (0.25, 0.25, 0.12))
        inside = (part > 0) & (part < 1)
        swing = np.where(inside, np.sin(2 * np.pi * part), 0.0) * _bump(part)
        moved += swing[:, None] * rng.normal(0, (0.9, 0.9, 0.6))
    return moved, angle


def _handle(time_s: Array, idle: Idle, rng: np.random.Generator) -> tuple[Array, Array]:
    """Take the sensor off, turn it in the hands and put it back."""
    moved, angle = np.zeros((len(time_s), 3)), np.zeros((len(time_s), 3))
    length_s = idle.end_s - idle.start_s
    envelope = smooth_step((time_s - idle.start_s) / 0.8) * smooth_step((idle.end_s - time_s) / 0.8)
    for hz in rng.uniform(0.3, 2.5, 6):
        swing = np.sin(2 * np.pi * (hz * time_s[:, None] + rng.uniform(0, 1, 3)))
        moved += envelope[:, None] * swing * rng.normal(0, 1.0, 3)
        angle += envelope[:, None] * swing * rng.normal(0, 0.25 / (1 + hz), 3)
    for knock_s in idle.start_s + length_s * rng.uniform(0.1, 0.9, 3):
        late = np.clip(time_s - knock_s, 0, None)
        shake = np.sin(2 * np.pi * 22.0 * late) * np.exp(-late / 0.03)
        moved += shake[:, None] * rng.normal(0, 4.0, 3)
    return moved, angle


def _ride(time_s: Array, idle: Idle, rng: np.random.Generator) -> tuple[Array, Array]:
    """Stand in a vehicle that comes from and goes to nowhere: it bounces, hums and sways."""
    moved, angle = np.zeros((len(time_s), 3)), np.zeros((len(time_s), 3))
    on = smooth_step((time_s - idle.start_s) / 2.0) * smooth_step((idle.end_s - time_s) / 2.0)
    for hz, across, up in (
        *((hz, 0.15, 0.35) for hz in rng.uniform(1.1, 1.8, 3)),  # on its springs
        *((hz, 0.05, 0.2) for hz in rng.uniform(9.0, 14.0, 3)),  # its wheels
        *((hz, 0.05, 0.08) for hz in rng.uniform(20.0, 35.0, 2)),  # its engine
    ):
        swing = np.sin(2 * np.pi * (hz * time_s[:, None] + rng.uniform(0, 1, 3)))
        gain = 1 + 0.6 * np.sin(2 * np.pi * (rng.uniform(0.05, 0.2) * time_s + rng.random()))
        moved += (on * gain)[:, None] * swing * (across, across, up)
        angle += on[:, None] * np.roll(swing, 1, axis=1) * (0.004 / hz, 0.012 / hz, 0.012 / hz)
    return moved, angle


def _bump(part: Array) -> Array:
    """Return 0 outside 0 to 1 and a smooth hill of height 1 between."""
    inside = np.clip(part, 0.0, 1.0)
    hill: Array = 64 * (inside * (1 - inside)) ** 3
    return hill


#: Of the waist's motion at the breastbone: acceleration ahead, left, up; yaw, pitch, roll. Chosen
#: by judgement: the trunk follows damped, and turns against the pelvis.
_TRUNK = (np.array((0.75, 0.85, 0.97)), np.array((-0.7, 0.8, -0.5)))
#: From the joint to the sensor, ahead, left, up [m]. Chosen by judgement: a trouser pocket, and a
#: wrist under a straight arm, of a usual person.
_THIGH_M = (0.06, -0.08, -0.22)
_ARM_M = (0.0, -0.03, -0.58)
#: Slower than this no gait repeats [Hz]; below it sums of steps would push the body off its path.
#: Chosen by judgement.
_SLOWEST_HZ = 0.15
#: Chosen by judgement: the filter has settled by then.
_FILTERED = 30  # samples that are filtered or settled at least
#: Faster than this no part of the body turns about its joints [Hz]. Chosen by judgement.
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
    filtered: Array = sosfiltfilt(sos, values, axis=0)
    return filtered


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
    acceleration = second_derivative(steps.position, time_s) + sway.acceleration
    return Motion(acceleration, Rotation.from_euler("ZYX", steps.angle + sway.angle))


def second_derivative(position: Array, time_s: Array) -> Array:
    """Return the second derivative of ``position`` (n, 3) at even times, 0 at the ends, (n, 3)."""
    derivative = np.zeros_like(position)
    if len(time_s) > 2:
        spacing_s = time_s[1] - time_s[0]
        derivative[1:-1] = np.diff(position, 2, axis=0) / spacing_s**2
    return derivative


#: Chosen by judgement: a usual walker's step width, and a heel that clears the floor.
_ASIDE_M = 0.09  # from the body's path to a foot
_LIFT_M = {"forward": 0.10, "backward": 0.08, "left": 0.06, "right": 0.06}
#: Pitch of the foot over a forward swing, from heel-off (0) to contact (1) [rad], heel up positive.
#: Chosen by judgement: by the look of recorded feet: heel up after the push, toes up before the
#: contact.
_SWING = (0.0, 0.28, 0.62, 0.9, 1.0)
_PITCH_RAD = (0.0, 0.85, 0.12, -0.30, -0.26)
_SLAP_S = 0.09  # from contact to the whole sole on the floor
_SHAKE_HZ, _SHAKE_S = 32.0, 0.018
_HEEL_OFF = 0.25  # before the toes leave the floor, in steps


@dataclass(frozen=True, slots=True, eq=False)
class FootMotion:
    """Place along x, y, up [m] and yaw, pitch, roll [rad], each of shape (n, 3)."""

    position: Array
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
    position, angle = np.zeros((len(time_s), 3)), np.zeros((len(time_s), 3))
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
        position[begun:off, :2], angle[begun:off, 0] = here[:2], here[2]
        part = (time_s[off:on] - swing.off_s) / (swing.contact_s - swing.off_s)
        moved = here + smooth_step(part)[:, None] * (there - here)
        position[off:on, :2], angle[off:on, 0] = moved[:, :2], moved[:, 2]
        position[off:on, 2] = _LIFT_M[swing.bout.kind] * 64 * (part * (1 - part)) ** 3
        _pitch(angle[:, 1], swing, time_s)
        here, begun = there, on
    position[begun:, :2], angle[begun:, 0] = here[:2], here[2]
    for swing in swings:
        _land(position, swing, manner, time_s)
    return FootMotion(position, angle)


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


def _land(position: Array, swing: _Swing, manner: Manner, time_s: Array) -> None:
    """Add to ``position`` (n, 3) how a contact shakes the foot, which leaves it where it was."""
    near = slice(*np.searchsorted(time_s, (swing.contact_s, swing.contact_s + 0.2)))
    late = (time_s[near] - swing.contact_s) / _SHAKE_S
    soft = 1.0 if swing.bout.kind == "forward" else 0.5
    blow = soft * manner.impact * swing.strength * late * np.exp(-late)
    turn = 2 * np.pi * _SHAKE_HZ
    shake = blow * np.sin(turn * _SHAKE_S * late) / turn**2
    position[near] += shake[:, None] * (-12.0, 4.0, 18.0)


#: Chosen by judgement: how sensors are worn, far enough off that axes must be found.
_TILT_DEG = 20.0  # a sensor put on by hand, about each axis
_POCKET_DEG = (35.0, -80.0, 10.0)  # yaw, pitch, roll of a phone in a trouser pocket
_WRIST_DEG = (-90.0, 10.0, 80.0)


@dataclass(frozen=True, slots=True)
class Stride:
    """One type of step of one person: contacts a second [Hz], length of a step [m], vigour."""

    cadence_hz: float
    length_m: float
    strength: float


@dataclass(frozen=True, slots=True)
class Sensor:
    """How a sensor sits and what is wrong with it.

    Noise was measured in quiet seconds of published recordings, as the standard deviation of
    second differences over the root of 6, which the body's own sway does not reach: sensors at the
    lower back at 100 Hz (mobgap, two people) have 0.012 to 0.021 m/s2 and 0.0020 to 0.0028 rad/s,
    phones in the hand at 50 Hz (indoor-location-20) 0.67 to 0.85 uT. People who stand still move
    them by 0.02 to 0.05 m/s2 more.

    Attributes
    ----------
    mount_deg
        Yaw, pitch, roll of its axes against ahead, left, up [deg].
    acceleration, angular_velocity
        Standard deviation of the noise at 100 Hz [m/s2, rad/s]; grows with the root of the rate.
    magnetic_t
        Standard deviation of the magnetometer's noise [T].
    acceleration_bias, angular_velocity_bias
        Largest constant bias of an axis [m/s2, rad/s].
    acceleration_walk, angular_velocity_walk
        Random walk of the biases, per root of a second.
    scale
        Standard deviation of the axes' scale errors.
    band_limited
        True: samples follow a low-pass at 0.4 of the rate, as in a real sensor.
    """

    mount_deg: tuple[float, float, float]
    acceleration: float
    angular_velocity: float
    magnetic_t: float
    acceleration_bias: float
    angular_velocity_bias: float
    acceleration_walk: float = 0.0
    angular_velocity_walk: float = 0.0
    scale: float = 0.0
    band_limited: bool = True


@dataclass(frozen=True, slots=True)
class Person:
    """A walker and their sensor.

    Attributes
    ----------
    manner
        Of walking.
    sensor
        Worn.
    strides
        By type of step.
    unsteady
        Standard deviation of the time between contacts, relative.
    swing
        Gain of the swing of arms and thighs.
    """

    manner: Manner
    sensor: Sensor
    strides: dict[StepType, Stride] = field(default_factory=dict)
    unsteady: float = 0.025
    swing: float = 1.0


#: Who walks the bundled recording.
STANDARD = Person(
    Manner(),
    Sensor((23.0, -71.0, 14.0), 0.025, 0.0015, 0.3e-6, 0.06, 0.004, band_limited=False),
)


def person(options: WalkOptions) -> Person:
    """Return the standard person, or draw one from ``options.person`` or else the seed.

    Cadences are even in 0.7 to 2.2 Hz. The vigour of steps (accelerations ahead and sideways;
    its square upward) varies threefold, at the same cadence twofold; each axis has its own gain.
    """
    if options.standard:
        return STANDARD
    seed = options.seed if options.person is None else options.person
    rng = np.random.default_rng([seed, 11])
    manner = _manner(rng)
    strides = _strides(rng)
    unsteady = float(rng.uniform(0.02, 0.045))
    swing = float(rng.uniform(0.6, 1.3))
    sensor = _sensor(rng)
    nominal = {"phone": _POCKET_DEG, "wrist": _WRIST_DEG}.get(options.placement, (0.0, 0.0, 0.0))
    yaw, pitch, roll = (a + b for a, b in zip(nominal, sensor.mount_deg, strict=True))
    sensor = replace(sensor, mount_deg=(yaw, pitch, roll))
    return Person(manner, sensor, strides, unsteady, swing)


def _manner(rng: np.random.Generator) -> Manner:
    ahead, aside, up = np.exp(0.15 * np.clip(rng.standard_normal(3), -2, 2)).tolist()
    return Manner(
        ahead=ahead,
        aside=aside,
        up=up,
        lag=float(0.015 * np.clip(rng.standard_normal(), -2, 2)),
        hump=float(rng.uniform(0.6, 1.3)),
        impact=float(rng.uniform(0.4, 1.4)),
        turning=float(rng.uniform(0.6, 1.4)),
        lean_rad=float(rng.uniform(-0.01, 0.08)),
        double_support=float(rng.uniform(0.18, 0.32)),
        asymmetry=float(rng.uniform(-0.08, 0.08)),
        rock=float(rng.uniform(-np.pi, np.pi)),
    )


def _strides(rng: np.random.Generator) -> dict[StepType, Stride]:
    """Draw how somebody steps; the time of a side step hardly depends on the person's cadence."""
    cadence_hz = rng.uniform(0.7, 2.2)
    quick = cadence_hz / 1.85
    length_m = 0.70 * quick**0.5 * rng.uniform(0.9, 1.12)
    strength = np.exp(rng.uniform(np.log(0.7), np.log(1.4))) * quick**0.4
    back_hz = cadence_hz * rng.uniform(0.8, 1.0)
    back_m = length_m * rng.uniform(0.55, 0.8)
    side_s = rng.uniform(0.45, 0.68)
    side_m = rng.uniform(0.13, 0.23)  # half a side stride: per contact
    # What moves a body by a side stride and stops it again follows from length and time.
    side = (side_m / 0.175) * (0.5 / side_s) ** 2 * rng.uniform(0.85, 1.15)
    back = strength * rng.uniform(0.6, 0.9)
    steps: dict[StepType, tuple[float, float, float]] = {
        "forward": (cadence_hz, length_m, strength),
        "backward": (back_hz, back_m, back),
        "left": (1 / side_s, side_m, side),
        "right": (1 / side_s, side_m * rng.uniform(0.9, 1.1), side * rng.uniform(0.9, 1.1)),
    }
    return {kind: Stride(*(float(x) for x in values)) for kind, values in steps.items()}


def _sensor(rng: np.random.Generator) -> Sensor:
    yaw, pitch, roll = rng.uniform(-_TILT_DEG, _TILT_DEG, 3).tolist()
    return Sensor(
        mount_deg=(yaw, pitch, roll),
        acceleration=float(rng.uniform(0.012, 0.021)),
        angular_velocity=float(rng.uniform(0.0020, 0.0028)),
        magnetic_t=float(rng.uniform(0.67e-6, 0.85e-6)),
        acceleration_bias=0.08,
        angular_velocity_bias=0.01,
        acceleration_walk=float(rng.uniform(2e-4, 1e-3)),
        angular_velocity_walk=float(rng.uniform(1e-5, 6e-5)),
        scale=0.005,
    )


PlacementName = Literal["waist", "trunk", "foot", "phone", "wrist"]
RouteName = Literal["straight", "l", "loop", "epfl", "random"]

#: Length of a walk whose path does not say how long it takes [s]. Chosen by judgement: one cycle,
#: and two of them.
_DURATION_S = {None: 60.0, "random": 120.0}


@dataclass(frozen=True, slots=True)
class WalkOptions:
    """What to simulate on a walking person.

    With nothing but ``seed``, ``duration_s`` and ``rate_hz``: the bundled walk, the standard
    person of :data:`STANDARD` on the minute of :func:`plan`. Whatever else is asked
    of the walker draws a person and takes a path.

    Attributes
    ----------
    seed
        Of everything that is random.
    duration_s
        Length [s]; the walk is cut or goes on round its path. None: once along the path, two
        minutes of a random one, a minute of the bundled one.
    rate_hz
        Of accelerometer and gyroscope [Hz], 6 to 400; the magnetometer has half of it, at most
        50 Hz, the barometer a tenth, at least 1 Hz.
    placement
        Where the sensor is worn. Waist, trunk and foot: axes ahead, left, up; phone: in the right
        trouser pocket; wrist: the right one.
    path
        ``straight`` 40 m, to and fro; ``l`` 20 m and 15 m; ``loop`` of 20 x 12 m; ``epfl`` of
        100 x 30 m with magnetic disturbances; ``random`` legs of 5 to 20 m.
    types
        True: stops for backward, left and right steps on the way; the label of a step is its type.
    person
        Seed of the person, where it is not to follow ``seed``.
    with_idle
        True: stops for sitting down, reaching, handling the sensor, riding in a vehicle.
    gnss
        True: positions once a second.
    disturbances
        How many stretches of the path disturb the magnetic field, to 50; None: those of the path.
    hard_iron_t
        Length of the field the carrier adds in the sensor's axes [T], to 1e-4.
    soft_iron
        By how much the carrier's iron stretches the field along one of its axes, to 0.3.
    """

    seed: int = 2
    duration_s: float | None = None
    rate_hz: float = 100.0
    placement: PlacementName = "waist"
    path: RouteName | None = None
    types: bool = False
    person: int | None = None
    with_idle: bool = False
    gnss: bool = False
    disturbances: int | None = None
    hard_iron_t: float | None = None
    soft_iron: float | None = None

    @property
    def standard(self) -> bool:
        """True for the standard person's minute."""
        asked = self.types or self.with_idle or self.person is not None or self.path is not None
        return self.placement == "waist" and not asked

    def resolved(self) -> WalkOptions:
        """Return the options with the path chosen and, where it is fixed, the length.

        Raises
        ------
        SimulationError
            Where an option is out of its range.
        """
        for name, good, expected, actual in self._limits():
            if not good:
                raise SimulationError(f"simulate walk: {name}: expected {expected}, found {actual}")
        path = self.path if self.standard else self.path or "random"
        duration_s = _DURATION_S.get(path) if self.duration_s is None else self.duration_s
        return replace(self, path=path, duration_s=duration_s)

    def _limits(self) -> Iterator[tuple[str, bool, str, Any]]:
        duration_s = 1.0 if self.duration_s is None else self.duration_s
        yield "duration_s", 0 < duration_s < np.inf, "> 0", duration_s
        yield "seed", self.seed >= 0, "0 or more", self.seed
        yield "rate_hz", 6 <= self.rate_hz <= 400, "6 to 400", self.rate_hz
        places, routes = get_args(PlacementName), get_args(RouteName)
        yield "placement", self.placement in places, " or ".join(places), self.placement
        yield "path", self.path in (None, *routes), " or ".join(routes), self.path
        yield "person", self.person is None or self.person >= 0, "0 or more", self.person
        count = self.disturbances
        yield "disturbances", count is None or 0 <= count <= 50, "0 to 50", count
        yield "hard_iron_t", 0 <= (self.hard_iron_t or 0) <= 1e-4, "0 to 1e-4 T", self.hard_iron_t
        yield "soft_iron", 0 <= (self.soft_iron or 0) <= 0.3, "0 to 0.3", self.soft_iron
