"""The magnetic field along a walk: the earth's, what stands beside the path, the carrier's iron."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .routes import LAPS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .gait import Plan
    from .walk_options import WalkOptions

    Array = NDArray[np.float64]

#: East, north, up [T]: of the bundled recording, and 48 uT with a dip of 63 degrees.
_BUNDLED_T = np.array((0.0, 20e-6, -44e-6))
_EARTH_T = 48e-6 * np.array((0.0, np.cos(np.radians(63.0)), -np.sin(np.radians(63.0))))
#: From this on the field counts as disturbed [T].
DISTURBED_T = 2e-6
_STRONG_T, _WEAK_T = (10e-6, 60e-6), (3e-6, 6e-6)
_WIDE_M = (2.0, 10.0)
_Group = tuple[int, tuple[float, float], tuple[float, float]]
#: Of the loop of EPFL: how many, how strong, between which places along it [m]: weak ones on the
#: first straight, strong ones on the second.
_EPFL: tuple[_Group, ...] = ((3, _WEAK_T, (5.0, 95.0)), (9, _STRONG_T, (132.0, 228.0)))


@dataclass(frozen=True, slots=True)
class Disturbance:
    """Something of iron beside the path.

    Attributes
    ----------
    middle_m, width_m
        Where along the path it is passed, and over how much of the path it reaches [m].
    offset_t
        What it adds to the field at the middle, east, north, up [T].
    """

    middle_m: float
    width_m: float
    offset_t: tuple[float, float, float]


def disturbances(options: WalkOptions, plan: Plan, duration_s: float) -> tuple[Disturbance, ...]:
    """Draw what disturbs the field over the path that is walked, or over each lap of it."""
    rng = np.random.default_rng([options.seed, 13])
    groups: tuple[_Group, ...] = ()
    if options.disturbances is not None:
        walked_m = float(plan.progress(np.arange(0.0, duration_s, 0.05))[-1])
        groups = ((options.disturbances, _STRONG_T, (0.0, lap_length_m(options) or walked_m)),)
    elif options.path == "epfl":
        groups = _EPFL
    return tuple(
        Disturbance(
            float(share * (high - low) + low),
            float(rng.uniform(*_WIDE_M)),
            _offset(float(rng.uniform(*strength)), rng),
        )
        for count, strength, (low, high) in groups
        for share in (np.arange(count) + rng.uniform(0.1, 0.9, count)) / max(count, 1)
    )


def lap_length_m(options: WalkOptions) -> float | None:
    """Return after how much path the field repeats [m]: a lap of a closed path, else None."""
    if options.path in ("loop", "epfl"):
        return sum(length for length, _ in LAPS[options.path])
    return None


def _offset(strength_t: float, rng: np.random.Generator) -> tuple[float, float, float]:
    """Return a vector of the given length in a random direction."""
    direction = rng.standard_normal(3)
    x, y, z = (strength_t * direction / np.linalg.norm(direction)).tolist()
    return x, y, z


def disturbing_field(found: tuple[Disturbance, ...], along_m: Array, lap_m: float | None) -> Array:
    """Return what disturbs the field after ``along_m`` (n,) metres of path, (n, 3) [T].

    A disturbance rises and falls as a squared cosine of the path.
    """
    field = np.zeros((len(along_m), 3))
    along_m = along_m if lap_m is None else along_m % lap_m
    for one in found:
        part = np.clip((along_m - one.middle_m) / one.width_m, -0.5, 0.5)
        field += (np.cos(np.pi * part) ** 2)[:, None] * one.offset_t
    return field


def earth(options: WalkOptions) -> Array:
    """Return the undisturbed field, east, north, up, shape (3,) [T]."""
    return _BUNDLED_T if options.standard else _EARTH_T


def through_iron(field: Array, options: WalkOptions) -> Array:
    """Return ``field`` (n, 3) in the sensor's axes as the carrier's iron leaves it, (n, 3) [T].

    Soft iron stretches it along one axis drawn at random, hard iron adds a constant.
    """
    rng = np.random.default_rng([options.seed, 14])
    axis, hard = (v / np.linalg.norm(v) for v in rng.standard_normal((2, 3)))
    stretched = field + (options.soft_iron or 0.0) * (field @ axis)[:, None] * axis
    passed: Array = stretched + (options.hard_iron_t or 0.0) * hard
    return passed
