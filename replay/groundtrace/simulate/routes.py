"""Routes drawn at random: legs and turns, stops, and steps of other types on the way."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import cycle
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from .gait import LATERAL, Bout, Idle, Plan, Turn, step_asymmetry

if TYPE_CHECKING:
    from collections.abc import Iterator

    from .gait import Activity, Foot, Person, RouteName, StepType, Stride, WalkOptions

_T = TypeVar("_T")
#: A turn to the left [rad]. Source: definition.
_LEFT = np.pi / 2
#: Legs and the turns at their ends [m, rad]; the last turn leads into the next lap. Source: EPFL
#: for "epfl", 260 m round; the others chosen by judgement: a corridor, a corner, a building.
LAPS: dict[RouteName, tuple[tuple[float, float], ...]] = {
    "straight": ((40.0, np.pi),),
    "l": ((20.0, _LEFT), (15.0, np.pi)),
    "loop": ((20.0, _LEFT), (12.0, _LEFT), (20.0, _LEFT), (12.0, _LEFT)),
    "epfl": ((100.0, _LEFT), (30.0, _LEFT), (100.0, _LEFT), (30.0, _LEFT)),
}
#: Chosen by judgement: long enough to level a sensor, and to see a track end; nothing that people
#: do between walks lasts longer.
_STILL_S = (4.0, 6.0)  # standing at the start, and at the end
_LONGEST_S: dict[Activity, float] = {"sit": 12.0, "reach": 5.0, "handle": 8.0, "ride": 30.0}
_OTHERS: tuple[StepType, ...] = ("backward", "left", "right")


@dataclass(frozen=True, slots=True)
class Stretch:
    """A walk without a stop, and what follows it.

    Attributes
    ----------
    kind
        Type of its steps.
    legs
        Lengths [m] and the turns at their ends [rad]; the last has none.
    pause_s
        Standing after it [s].
    activity
        What is done then, or None.
    """

    kind: StepType
    legs: tuple[tuple[float, float], ...]
    pause_s: float
    activity: Activity | None = None

    @property
    def length_m(self) -> float:
        """Length of all legs [m]."""
        return sum(length for length, _ in self.legs)


def route_plan(options: WalkOptions, person: Person) -> tuple[Plan, float]:
    """Return the plan of a walk along ``options.path``, and its length [s]."""
    rng = np.random.default_rng([options.seed, 12])
    bouts: list[Bout] = []
    turns: list[Turn] = []
    idles: list[Idle] = []
    now_s = float(rng.uniform(*_STILL_S))
    for stretch in _stretches(options, person, rng):
        bout = _bout(stretch, person, now_s, rng)
        turns += _turns(stretch, bout)
        bouts.append(bout)
        now_s = bout.span_s[1] + stretch.pause_s
        if stretch.activity is not None:
            idles.append(Idle(bout.span_s[1] + 0.8, now_s - 0.8, stretch.activity))
        if options.duration_s is not None and now_s >= options.duration_s:
            break
    if options.duration_s is None:
        return Plan(tuple(bouts), tuple(turns), (), tuple(idles)), float(np.ceil(now_s))
    return _cut(Plan(tuple(bouts), tuple(turns), (), tuple(idles)), options.duration_s)


def _cut(plan: Plan, duration_s: float) -> tuple[Plan, float]:
    """Leave out what begins after the end."""
    kept = Plan(
        tuple(b for b in plan.bouts if b.span_s[0] < duration_s),
        tuple(t for t in plan.turns if t.start_s < duration_s),
        (),
        tuple(i for i in plan.idles if i.start_s < duration_s),
    )
    return kept, duration_s


def _stretches(options: WalkOptions, person: Person, rng: np.random.Generator) -> Iterator[Stretch]:
    """Yield walks: one lap, or more than enough where the length is given.

    Only the random path stops by itself; other types and idle time make stops on any path.
    """
    stopping = options.types or options.with_idle or options.path == "random"
    others = _in_turn(_OTHERS, rng) if options.types else None
    pauses = _pauses(options, rng)
    legs: list[tuple[float, float]] = []
    for length_m, turn_rad in _legs(options, person, rng):
        rest_m = length_m
        while stopping and rest_m > 8.0 and rng.random() < 0.8:
            part_m = min(float(rng.uniform(4.0, 12.0)), rest_m - 4.0)
            rest_m -= part_m
            yield Stretch("forward", (*legs, (part_m, 0.0)), *next(pauses))
            legs = []
            if others is not None:
                yield _other(next(others), person, rng, *next(pauses))
        legs.append((rest_m, turn_rad))
        if turn_rad == 0.0:
            yield Stretch("forward", tuple(legs), float(rng.uniform(*_STILL_S)))
            legs = []


def _legs(
    options: WalkOptions, person: Person, rng: np.random.Generator
) -> Iterator[tuple[float, float]]:
    """Yield legs and the turns at their ends; the last has none."""
    stride = person.strides["forward"]
    speed_mps = stride.cadence_hz * stride.length_m
    enough_m = 0.0 if options.duration_s is None else 1.3 * speed_mps * options.duration_s
    lap = LAPS.get(options.path) if options.path else None
    for index, (length_m, turn_rad) in enumerate(_random_legs(rng) if lap is None else cycle(lap)):
        enough_m -= length_m
        ended = enough_m <= 0 and (lap is None or (index + 1) % len(lap) == 0)
        yield length_m, 0.0 if ended else turn_rad
        if ended:
            return


def _random_legs(rng: np.random.Generator) -> Iterator[tuple[float, float]]:
    while True:
        angle = float(rng.choice((-1, 1)) * np.radians(rng.uniform(30, 120)))
        yield float(rng.uniform(5, 20)), angle


def _in_turn(choices: tuple[_T, ...], rng: np.random.Generator) -> Iterator[_T]:
    """Yield the choices in random order, each as often as the rest."""
    while True:
        yield from (choices[i] for i in rng.permutation(len(choices)))


def _other(
    kind: StepType,
    person: Person,
    rng: np.random.Generator,
    pause_s: float,
    activity: Activity | None,
) -> Stretch:
    """Return 3 to 7 side steps or 5 to 10 backward ones."""
    steps = 2 * int(rng.integers(3, 8)) if kind in LATERAL else int(rng.integers(5, 11))
    length_m = (steps - 1.5) * person.strides[kind].length_m
    return Stretch(kind, ((length_m, 0.0),), pause_s, activity)


def _pauses(
    options: WalkOptions, rng: np.random.Generator
) -> Iterator[tuple[float, Activity | None]]:
    """Yield how long stops take, and what is done in them: in every second one, if anything."""
    activities = _in_turn(tuple(_LONGEST_S), rng)
    while True:
        if options.with_idle and rng.random() < 0.5:
            activity = next(activities)
            yield float(rng.uniform(0.6, 1.0)) * _LONGEST_S[activity], activity
        else:
            yield float(rng.uniform(1.0, 4.0)), None


def _bout(stretch: Stretch, person: Person, start_s: float, rng: np.random.Generator) -> Bout:
    """Return the steps of a stretch: its length is walked exactly, with whole steps."""
    stride = person.strides[stretch.kind]
    # The body starts and stops within 1.5 steps each, see Bout.ground_speed.
    count = max(4, round(stretch.length_m / stride.length_m + 1.5))
    if stretch.kind in LATERAL:
        count += count % 2
    gap_s = _gaps(stride, person, count, rng)
    contact_s = np.round(start_s + gap_s.mean() / 2 + np.cumsum(gap_s) - gap_s[0], 6)
    first = _first_foot(stretch.kind, rng)
    strength = stride.strength * (1 + 0.08 * rng.standard_normal(count))
    strength *= step_asymmetry(stretch.kind, first, count, person.manner)
    strength[[0, -1]] *= 0.7
    walked_s = contact_s[-1] - contact_s[0] - 0.5 * np.diff(contact_s).mean()
    return Bout(contact_s, strength, stretch.length_m / float(walked_s), stretch.kind, first)


def _gaps(stride: Stride, person: Person, count: int, rng: np.random.Generator) -> np.ndarray:
    """Draw the times between contacts [s]: steps differ, and the pace wanders slowly."""
    steps = person.unsteady * np.clip(rng.standard_normal(count), -3, 3)
    wander = 0.03 * np.sin(2 * np.pi * (np.arange(count) / rng.uniform(15, 40) + rng.random()))
    gaps: np.ndarray = (1 + steps + wander) / stride.cadence_hz
    return gaps


def _first_foot(kind: StepType, rng: np.random.Generator) -> Foot:
    """Return the foot that starts: to the side, the one of that side leads."""
    drawn: Foot = "left" if rng.random() < 0.5 else "right"
    if kind == "left" or kind == "right":
        return kind
    return drawn


def _turns(stretch: Stretch, bout: Bout) -> Iterator[Turn]:
    """Yield the turns between the legs: three steps for a right angle, two at least."""
    walked_m = np.cumsum([length for length, _ in stretch.legs])[:-1]
    for done_m, (_, angle) in zip(walked_m.tolist(), stretch.legs, strict=False):
        length_s = bout.step_s * max(2.0, 3.0 * abs(angle) / (np.pi / 2))
        middle_s = bout.span_s[0] + 0.75 * bout.step_s + done_m / bout.speed_mps
        yield Turn(middle_s - length_s / 2, length_s, angle)
