"""Who strikes the floor: one person, two who cross, or single impacts."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from .footfall import Footfall
from .options import refused
from .paths import paths_in, polygon

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from .footfall import Shoe
    from .options import RoomOptions
    from .paths import Path

    Outline = tuple[tuple[float, float], ...]

_FIRST_S = 0.8
_AFTER_LAST_S = 1.2
_STEPS = 20
_IMPACT_S = (1.0, 3.0)  # between two impacts
_FROM_WALL_M = 0.3  # of an impact


@dataclass(frozen=True, slots=True)
class Strike:
    """A step or an impact.

    Attributes
    ----------
    time_ns
        After the first sample [ns].
    x_m, y_m
        Place [m].
    footfall
        Its force.
    foot
        ``left`` or ``right``; empty for an impact.
    target
        Which walker; empty where there is one.
    """

    time_ns: int
    x_m: float
    y_m: float
    footfall: Footfall
    foot: str = ""
    target: str = ""


@dataclass(frozen=True, slots=True)
class Gait:
    """How a person walks; the defaults are the thesis's pace, 0.5 to 0.6 s a step.

    Attributes
    ----------
    interval_s, interval_sd_s
        From one step to the next, mean and standard deviation [s].
    shortest_s, longest_s
        Limits of it [s].
    pace_m, pace_sd_m
        Length of a step [m].
    strength, hardness
        Factors of the footfall's force and frequencies.
    """

    interval_s: float = 0.55
    interval_sd_s: float = 0.025
    shortest_s: float = 0.5
    longest_s: float = 0.6
    pace_m: float = 0.58
    pace_sd_m: float = 0.02
    strength: float = 1.0
    hardness: float = 1.0


#: The first walker, and a second one: slower, longer steps, lighter and softer.
GAITS = (Gait(), Gait(0.63, 0.03, 0.55, 0.71, 0.64, 0.025, 0.8, 0.88))


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """What strikes the floor during the recording.

    Attributes
    ----------
    strikes
        In order of time.
    duration_s
        Of the recording [s].
    start
        Where the first walker starts [m], or None.
    """

    strikes: tuple[Strike, ...]
    duration_s: float
    start: tuple[float, float] | None = None


def course_of(options: RoomOptions, outline: Outline, shoes: Sequence[Shoe]) -> Course:
    """Draw the strikes.

    Raises
    ------
    SimulationError
        Where the outline is too narrow or the steps do not fit in the duration.
    """
    if options.impacts:
        return _impacts(options, outline, shoes)
    paths = paths_in(outline, options.path or ("crossing" if options.walkers == 2 else "u"))
    delays_s = _meeting(paths)
    strikes: list[Strike] = []
    duration_s = 0.0
    for number, (path, delay_s) in enumerate(zip(paths, delays_s, strict=True)):
        rng = np.random.default_rng([options.seed, 1 if number == 0 else 3 + number])
        walked, needed_s = _walked(options, GAITS[number], path, rng, delay_s)
        target = str(number + 1) if len(paths) > 1 else ""
        strikes += [replace(x, target=target) for x in walked]
        duration_s = max(duration_s, needed_s)
    strikes.sort(key=lambda x: x.time_ns)
    x, y = np.round(paths[0].points[0], 4).tolist()
    return Course(_shod(strikes, shoes, options.seed), duration_s, (x, y))


def _meeting(paths: Sequence[Path]) -> list[float]:
    """Return how long each walker waits, so that all are halfway along their paths at once [s]."""
    halfway_s = [
        path.length_m / 2 * gait.interval_s / gait.pace_m
        for path, gait in zip(paths, GAITS, strict=False)
    ]
    return [max(halfway_s) - x for x in halfway_s]


def _walked(
    options: RoomOptions, gait: Gait, path: Path, rng: np.random.Generator, delay_s: float
) -> tuple[list[Strike], float]:
    """Draw the steps of a walker and the duration they need [s]."""
    wanted = _wanted(options, 0.5)
    gaps = rng.normal(gait.interval_s, gait.interval_sd_s, wanted)
    gaps = np.clip(gaps, gait.shortest_s, gait.longest_s)
    time_s = _FIRST_S + delay_s + np.concatenate(([0.0], np.cumsum(gaps[1:])))
    fitting, duration_s = _fitting(options, time_s)
    run_m = np.cumsum(rng.normal(gait.pace_m, gait.pace_sd_m, wanted))
    places = path.feet(run_m[:fitting] - run_m[0]).tolist()
    times_ns = np.rint(time_s[:fitting] * NS_PER_S).astype(np.int64).tolist()
    footfalls = [Footfall.drawn(rng) for _ in range(fitting)]
    strikes = [
        Strike(
            time_ns,
            x,
            y,
            replace(
                footfall,
                strength=footfall.strength * gait.strength,
                hardness=footfall.hardness * gait.hardness,
            ),
            ("left", "right")[index % 2],
        )
        for index, (time_ns, (x, y), footfall) in enumerate(
            zip(times_ns, places, footfalls, strict=True)
        )
    ]
    return strikes, duration_s


def _impacts(options: RoomOptions, outline: Outline, shoes: Sequence[Shoe]) -> Course:
    import shapely

    rng = np.random.default_rng([options.seed, 1])
    gaps = rng.uniform(*_IMPACT_S, _wanted(options, _IMPACT_S[0]))
    time_s = _FIRST_S + np.concatenate(([0.0], np.cumsum(gaps[1:])))
    fitting, duration_s = _fitting(options, time_s)
    clear = polygon(outline).buffer(-_FROM_WALL_M)
    if clear.is_empty:
        raise refused("outline", "room for impacts", "none")
    low, high = np.array(clear.bounds).reshape(2, 2)
    strikes: list[Strike] = []
    while len(strikes) < fitting:
        x, y = np.round(rng.uniform(low, high), 4).tolist()
        if shapely.intersects_xy(clear, x, y):
            footfall = replace(Footfall.drawn(rng), toe=0.0)
            time_ns = round(time_s[len(strikes)] * NS_PER_S)
            strikes.append(Strike(time_ns, x, y, footfall))
    return Course(_shod(strikes, shoes, options.seed), duration_s)


def _wanted(options: RoomOptions, shortest_s: float) -> int:
    most = _STEPS if options.duration_s is None else int(options.duration_s / shortest_s)
    return options.steps or max(most, 1)


def _fitting(options: RoomOptions, time_s: NDArray[np.float64]) -> tuple[int, float]:
    """Return how many of the strikes fit, and the duration [s]."""
    duration_s = options.duration_s or float(np.ceil(time_s[-1] + _AFTER_LAST_S))
    fitting = int(np.count_nonzero(time_s < duration_s - _AFTER_LAST_S / 2))
    wanted = options.steps or 1
    if fitting < wanted:
        raise refused("steps", f"{fitting} or fewer in {duration_s:g} s", wanted)
    return fitting, duration_s


def _shod(strikes: Sequence[Strike], shoes: Sequence[Shoe], seed: int) -> tuple[Strike, ...]:
    """Put a shoe on every strike, one of them at random."""
    chosen = np.random.default_rng([seed, 7]).integers(len(shoes), size=len(strikes)).tolist()
    return tuple(
        replace(x, footfall=replace(x.footfall, shoe=shoes[k]))
        for x, k in zip(strikes, chosen, strict=True)
    )
