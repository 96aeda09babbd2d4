"""A pedestrian's plan: when the feet touch the floor, how fast and where the body goes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

StepType = Literal["forward", "backward", "left", "right"]
Foot = Literal["left", "right"]
Activity = Literal["sit", "reach", "handle", "ride"]

#: Types of side steps: a lead and a trail foot make one step.
LATERAL = frozenset({"left", "right"})
#: Where a step goes against where the body faces [rad], counter-clockwise.
COURSE_RAD: dict[StepType, float] = {
    "forward": 0.0,
    "backward": np.pi,
    "left": np.pi / 2,
    "right": -np.pi / 2,
}

CYCLE_S = 60.0
#: Walks of a cycle: start, end, mean step time, step length, [s, s, s, m]. Standing lies between.
_WALKS = ((5.0, 34.0, 0.54, 0.70), (39.0, 53.0, 0.66, 0.55))
#: Start and length of the left turn by 90 degrees, within the first walk [s].
_TURN = (25.0, 2.4)
#: The pause in which the person fidgets [s].
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
        whole = np.interp(time_s, self.contact_s, np.arange(len(self.contact_s)))
        before = np.minimum(time_s - self.contact_s[0], 0) / self.step_s
        after = np.maximum(time_s - self.contact_s[-1], 0) / self.step_s
        phase: NDArray[np.float64] = whole + before + after
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
            kept = int(np.count_nonzero(bout.contact_s < duration_s - 1.0))
            if kept >= 2:
                bouts.append(Bout(bout.contact_s[:kept], bout.strength[:kept], bout.speed_mps))
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
