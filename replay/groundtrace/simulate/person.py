"""People who differ, and how each wears an imperfect sensor."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from .gait_shapes import Manner

if TYPE_CHECKING:
    from .gait import StepType
    from .walk_options import WalkOptions

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
