"""Made-up motion of a foot whose place is known at every moment: stances, and smooth swings."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from made_rotations import of_vectors

from groundtrace.inertial.rotations import matrix
from groundtrace_codecs.signals import NS_PER_S, Channel, SignalBlock, Stream

START_NS = 1_700_000_000_000_000_000
G = 9.80665


@dataclass(frozen=True)
class Gait:
    """Strides of one foot.

    ``turns_rad`` has the change of heading of each stride; the foot pitches by ``pitch_rad`` in
    the middle of a swing.
    """

    turns_rad: tuple[float, ...]
    stride_m: float = 1.3
    swing_s: float = 0.45
    stance_s: float = 0.55
    rest_s: float = 2.0
    height_m: float = 0.12
    pitch_rad: float = 0.9

    @property
    def length_s(self) -> float:
        return 2 * self.rest_s + len(self.turns_rad) * (self.swing_s + self.stance_s)


@dataclass(frozen=True)
class Sensor:
    """What is wrong with a sensor, and how it is worn (a rotation vector)."""

    worn: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gyro_bias: tuple[float, float, float] = (0.0, 0.0, 0.0)
    force_bias: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gyro_noise: float = 0.0
    force_noise: float = 0.0
    seed: int = 3


@dataclass(frozen=True)
class FootWalk:
    """A block of signal, and where the foot was at each sample, shape (n, 3) [m]."""

    block: SignalBlock
    place: np.ndarray = field(repr=False)

    @property
    def walked_m(self) -> float:
        return float(np.linalg.norm(np.diff(self.place[:, :2], axis=0), axis=1).sum())


def circle(strides: int = 20, rounds: int = 1) -> Gait:
    """A gait that returns to where it began."""
    return Gait((2 * np.pi * rounds / strides,) * strides)


def foot_walk(gait: Gait, sensor: Sensor | None = None, rate_hz: float = 200.0) -> FootWalk:
    """What a sensor on that foot records."""
    sensor = sensor or Sensor()
    t = np.arange(round(gait.length_s * rate_hz)) / rate_hz
    place, acceleration = np.zeros((2, len(t), 3))
    yaw, pitch, yaw_rate, pitch_rate = np.zeros((4, len(t)))
    start_s, heading, here = gait.rest_s, 0.0, np.zeros(3)
    for turn in gait.turns_rad:
        way = gait.stride_m * np.array([np.cos(heading + turn / 2), np.sin(heading + turn / 2), 0])
        u = np.clip((t - start_s) / gait.swing_s, 0, 1)
        inside, after = (u > 0) & (u < 1), t >= start_s + gait.swing_s
        s, ds, dds = 10 * u**3 - 15 * u**4 + 6 * u**5, 30 * u**2 * (1 - u) ** 2, u * (1 - u)
        dds = 60 * dds * (1 - 2 * u)
        lift, dlift, ddlift = _bump(u)
        part = here + s[:, None] * way + (gait.height_m * lift)[:, None] * [0, 0, 1]
        place[inside] = part[inside]
        here = here + way
        place[after] = here
        push = (dds[:, None] * way + (gait.height_m * ddlift)[:, None] * [0, 0, 1])[inside]
        acceleration[inside] = push / gait.swing_s**2
        yaw[inside | after] = (heading + s * turn)[inside | after]
        yaw_rate[inside] = (ds * turn / gait.swing_s)[inside]
        pitch[inside] = (gait.pitch_rad * lift)[inside]
        pitch_rate[inside] = (gait.pitch_rad * dlift / gait.swing_s)[inside]
        heading, start_s = heading + turn, start_s + gait.swing_s + gait.stance_s
    force, rate = _in_body(acceleration, yaw, pitch, yaw_rate, pitch_rate)
    return FootWalk(_recorded(force, rate, sensor, rate_hz), place)


def _bump(u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """64 u^3 (1 - u)^3 and its derivatives."""
    v = u * (1 - u)
    return 64 * v**3, 192 * v**2 * (1 - 2 * u), 384 * v * ((1 - 2 * u) ** 2 - v)


def _in_body(
    acceleration: np.ndarray,
    yaw: np.ndarray,
    pitch: np.ndarray,
    yaw_rate: np.ndarray,
    pitch_rate: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Force and rate in the axes of a foot that is turned by yaw, then by pitch."""
    f = acceleration + np.array([0, 0, G])
    cy, sy, cp, sp = np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch)
    ahead, left, up = cy * f[:, 0] + sy * f[:, 1], cy * f[:, 1] - sy * f[:, 0], f[:, 2]
    force = np.stack([cp * ahead - sp * up, left, sp * ahead + cp * up], axis=1)
    rate = np.stack([-sp * yaw_rate, pitch_rate, cp * yaw_rate], axis=1)
    return force, rate


def _recorded(force: np.ndarray, rate: np.ndarray, sensor: Sensor, rate_hz: float) -> SignalBlock:
    axes = matrix(of_vectors(np.array(sensor.worn)))
    rng = np.random.default_rng(sensor.seed)
    force = force @ axes + sensor.force_bias + rng.normal(0, sensor.force_noise, force.shape)
    rate = rate @ axes + sensor.gyro_bias + rng.normal(0, sensor.gyro_noise, rate.shape)
    return SignalBlock(foot_stream(rate_hz), START_NS, 0, np.concatenate([force, rate], axis=1))


def foot_stream(rate_hz: float, topic: str = "/imu/foot", placement: str = "foot") -> Stream:
    channels = [Channel(f"acc_{a}", "acceleration", "m/s2", a) for a in "xyz"]
    channels += [Channel(f"gyr_{a}", "angular_velocity", "rad/s", a) for a in "xyz"]
    return Stream(topic, tuple(channels), rate_hz, placement)


def times_s(walk: FootWalk) -> np.ndarray:
    return (walk.block.sample_times() - START_NS) / NS_PER_S
