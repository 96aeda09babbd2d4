"""A worn sensor on a walk that another recording has: the same steps, another clock."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from ..errors import SimulationError
from .gait import Bout, Plan, Turn
from .magnetic import disturbances
from .person import person
from .simulation import START_NS, Simulation, described
from .walk_options import WalkOptions
from .walk_sensors import Walker
from .walk_truth import walk_labels

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.labels import Label
    from groundtrace_codecs.signals import SignalBlock

    from .gait import Foot

#: Steps further apart belong to two walks [s].
_STOP_S = 1.5
#: Length of a step where the places are not known [m].
_STEP_M = 0.6
_LEAST = 4


@dataclass(frozen=True, slots=True)
class Walked:
    """A walk that was recorded.

    Attributes
    ----------
    name
        Of the recording.
    steps
        Its steps, in order of time.
    start_ns, end_ns
        Of the recording [ns].
    """

    name: str
    steps: tuple[Label, ...]
    start_ns: int
    end_ns: int


@dataclass(frozen=True, slots=True)
class ClockError:
    """How a simulated clock is wrong: ahead at the recording's start [s], and fast [1e-6]."""

    ahead_s: float = 0.0
    drift_ppm: float = 0.0


def simulate_same_walk(
    walked: Walked, options: WalkOptions | None = None, clock: ClockError | None = None
) -> Simulation:
    """Simulate what a worn sensor records of a walk that another recording has.

    Contacts are those of the recording, in time and in foot; the body goes along the line between
    the feet. The sensor records as long as the recording.

    Parameters
    ----------
    walked
        The walk: one person's steps.
    options
        Of the person and the sensor; path and length are the recording's.
    clock
        How the sensor's clock is wrong.

    Raises
    ------
    SimulationError
        Where there are fewer than 4 steps in a row, the steps are those of several people, or an
        option is out of its range.
    """
    clock = clock or ClockError()
    who = {label.target for label in walked.steps}
    if len(who) > 1:
        raise SimulationError(f"{walked.name}: expected one walker, found {len(who)}")
    speed = 1 + clock.drift_ppm * 1e-6
    duration_s = (walked.end_ns - walked.start_ns) / NS_PER_S * speed
    chosen = replace(options or WalkOptions(), duration_s=duration_s).resolved()
    plan = _plan(walked, speed)
    walker = Walker(
        chosen, plan, person(chosen), duration_s, disturbances(chosen, plan, duration_s)
    )
    # the line bends at each step a little: none of these is a place to turn at
    labels = [x for x in walk_labels(walker) if (x.kind, x.label) != ("waypoint", "turn")]
    labels = _placed(labels, walked)
    later_ns = walked.start_ns - START_NS + round(clock.ahead_s * NS_PER_S)
    said = described("walk", chosen)
    said["simulation"] |= {
        "steps_of": walked.name,
        "clock_ahead_s": str(clock.ahead_s),
        "clock_drift_ppm": str(clock.drift_ppm),
    }
    return Simulation(
        sources=[(s.stream, "f64le", _Later(s, later_ns)) for s in walker.samples()],
        geometry=None,
        labels=tuple(_later(label, later_ns) for label in labels),
        metadata=said,
    )


@dataclass(frozen=True, slots=True)
class _Later:
    """Blocks some time later."""

    blocks: Iterable[SignalBlock]
    by_ns: int

    def __iter__(self) -> Iterator[SignalBlock]:
        for block in self.blocks:
            yield replace(block, anchor_ns=block.anchor_ns + self.by_ns)


def _later(label: Label, by_ns: int) -> Label:
    end_ns = None if label.end_ns is None else label.end_ns + by_ns
    return replace(label, time_ns=label.time_ns + by_ns, end_ns=end_ns)


def _plan(walked: Walked, speed: float) -> Plan:
    """Return the walks between stops, and the turns of the line between the feet."""
    steps = walked.steps
    times = np.array([(s.time_ns - walked.start_ns) / NS_PER_S * speed for s in steps])
    edges = [0, *(np.flatnonzero(np.diff(times) > _STOP_S) + 1).tolist(), len(times)]
    spans = [slice(a, b) for a, b in pairwise(edges) if b - a >= _LEAST]
    if not spans:
        raise SimulationError(
            f"{walked.name}: expected {_LEAST} steps in a row or more, found {len(times)} steps"
        )
    places = _middle(steps)
    bouts: list[Bout] = []
    turns: list[Turn] = []
    for span in spans:
        contact_s, place = times[span], places[span]
        walked_m = float(np.hypot(*np.diff(place, axis=0).T).sum()) or _STEP_M * len(place)
        moving_s = float(contact_s[-1] - contact_s[0]) - 0.5 * float(np.diff(contact_s).mean())
        first: Foot = "right" if steps[span.start].label == "right" else "left"
        strength = np.ones(len(contact_s))
        strength[[0, -1]] = 0.7
        speed_mps = walked_m / moving_s
        bouts.append(Bout(contact_s, strength, speed_mps, "forward", first))
        turns += _turns(contact_s, place, turns)
    return Plan(tuple(bouts), tuple(turns))


def _middle(steps: Sequence[Label]) -> NDArray[np.float64]:
    """Return where the body is at each step, between the feet, shape (n, 2) [m]."""
    if any(s.x_m is None or s.y_m is None for s in steps):
        along = np.arange(len(steps)) * _STEP_M
        return np.stack([along, np.zeros(len(steps))], axis=1)
    feet = np.array([(s.x_m, s.y_m) for s in steps], np.float64)
    middle = feet.copy()
    middle[1:] = (feet[1:] + feet[:-1]) / 2
    middle[0] += middle[1] - feet[1] if len(feet) > 1 else 0.0
    return middle


def _turns(
    contact_s: NDArray[np.float64], place: NDArray[np.float64], before: Sequence[Turn]
) -> list[Turn]:
    """Return a turn at each step at which the line bends, and one that faces its start."""
    legs = np.diff(place, axis=0)
    course = np.arctan2(legs[:, 1], legs[:, 0])
    facing = sum(turn.angle_rad for turn in before)
    turns = []
    step_s = float(np.diff(contact_s).mean())
    for k, angle in enumerate(course.tolist()):
        bend = float((angle - facing + np.pi) % (2 * np.pi) - np.pi)
        if abs(bend) > 1e-3:
            # before a walk begins its turn is over: nobody turns on the spot at its first step
            at_s = contact_s[0] - step_s if k == 0 else contact_s[k]
            turns.append(Turn(float(at_s) - step_s / 2, step_s, bend))
            facing += bend
    return turns


def _placed(labels: Sequence[Label], walked: Walked) -> list[Label]:
    """Return labels where the recording has the walk, not from the origin."""
    first, there = next((x for x in labels if x.kind == "step"), None), walked.steps[0]
    if first is None or there.x_m is None or first.x_m is None:
        return list(labels)
    x_m, y_m = there.x_m - first.x_m, (there.y_m or 0.0) - (first.y_m or 0.0)
    return [
        replace(x, x_m=round(x.x_m + x_m, 4), y_m=round((x.y_m or 0.0) + y_m, 4))
        if x.x_m is not None
        else x
        for x in labels
    ]
