"""A person walking, as an inertial sensor at the waist sees it.

The body moves as a point above the feet with the accelerations of level walking:

- up: twice a stride the body falls onto the next foot. At the waist the vertical acceleration
  passes its mean going up about when that foot touches the floor (initial contact) and peaks about
  0.1 s later, when the leg has taken the load; it is lowest while the body vaults over the stance
  leg. That order is described for sensors at the lower back by Zijlstra and Hof (Gait & Posture
  18, 2003) and is what the contacts of instrumented recordings show.
- forward: pushed off just before a contact, braked just after it.
- sideways: once a stride, towards the middle from each stance leg.
- the pelvis turns forward with the swinging leg and rolls once a stride, nods once a step.
- each contact shakes the waist for some tens of milliseconds.

What a sensor measures follows from the motion: it is mounted at an arbitrary angle, its
accelerometer feels the acceleration plus gravity in its own axes and its gyroscope the rotation
between samples.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.labels import Label
from groundtrace_codecs.signals import NS_PER_S, Channel, SignalBlock, Stream

from ..errors import SimulationError
from .gait import Bout, Plan, plan
from .simulation import AUTHOR, START_NS, Simulation, described

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray
    from scipy.spatial.transform import Rotation

GRAVITY_MPS2 = 9.80665
_MOUNT_DEG = (23.0, -71.0, 14.0)  # yaw, pitch, roll of the sensor on the belt
_FIELD_T = (0.0, 20e-6, -44e-6)  # east, north, up: central Europe
_NOISE = {"acceleration": 0.025, "angular_velocity": 0.0015}  # standard deviation at 100 Hz
_BIAS = {"acceleration": 0.06, "angular_velocity": 0.004}
_LSB = {"acceleration": 8 * GRAVITY_MPS2 / 32768, "angular_velocity": np.radians(1000) / 32768}
_UNITS = {"acceleration": "m/s2", "angular_velocity": "rad/s", "magnetic_field": "T"}


@dataclass(frozen=True, slots=True)
class WalkOptions:
    """What to simulate at the waist.

    Attributes
    ----------
    seed
        Of everything that is random.
    duration_s
        Length [s]; the plan of :func:`.gait.plan` repeats every minute.
    rate_hz
        Of accelerometer and gyroscope [Hz], 6 to 400; the magnetometer has half of it, at most
        50 Hz, the barometer a tenth, at least 1 Hz.
    placement
        Where the sensor is worn: ``waist`` is the one there is a model of.
    """

    seed: int = 2
    duration_s: float = 60.0
    rate_hz: float = 100.0
    placement: str = "waist"

    def check(self) -> None:
        """Raise SimulationError where an option is out of its range."""
        limits = (
            ("duration_s", 0 < self.duration_s < np.inf, "> 0", self.duration_s),
            ("seed", self.seed >= 0, "0 or more", self.seed),
            ("rate_hz", 6 <= self.rate_hz <= 400, "6 to 400", self.rate_hz),
            ("placement", self.placement == "waist", "waist", self.placement),
        )
        for name, good, expected, found in limits:
            if not good:
                raise SimulationError(f"simulate walk: {name}: expected {expected}, found {found}")


@dataclass(frozen=True, slots=True, eq=False)
class _Motion:
    """The waist in the world: acceleration (n, 3) [m/s2] and attitude (n,)."""

    acceleration: NDArray[np.float64]
    attitude: Rotation


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """The samples of one stream, shape (n_samples, n_channels), given a second at a time."""

    stream: Stream
    values: NDArray[np.float64]

    def __iter__(self) -> Iterator[SignalBlock]:
        size = max(1, round(self.stream.rate_hz))
        for first in range(0, len(self.values), size):
            yield SignalBlock(self.stream, START_NS, first, self.values[first : first + size])


def simulate_walk(options: WalkOptions | None = None) -> Simulation:
    """Simulate a walk with a sensor at the waist.

    The truth: ``step`` per initial contact with place and foot, ``heading`` [rad] with each,
    ``walking`` spans, and ``waypoint`` where the person starts, turns and stops.

    Raises
    ------
    SimulationError
        Where an option is out of its range.
    """
    options = options or WalkOptions()
    options.check()
    walk = plan(options.duration_s, np.random.default_rng([options.seed, 1]))
    inertial = _inertial(options, walk)
    magnetic = _magnetic(options, walk)
    pressure = _pressure(options)
    return Simulation(
        sources=[(s.stream, "f64le", s) for s in (inertial, magnetic, pressure)],
        geometry=None,
        labels=_labels(walk, options.duration_s),
        metadata=described("walk", options),
    )


def _grid(duration_s: float, rate_hz: float) -> NDArray[np.float64]:
    """Return the times of the samples [s], shape (n,)."""
    return np.arange(max(1, round(duration_s * rate_hz))) / rate_hz


def _motion(options: WalkOptions, walk: Plan, time_s: NDArray[np.float64]) -> _Motion:
    """Return how the waist moves at ``time_s``."""
    from scipy.spatial.transform import Rotation

    heading = walk.heading(time_s)
    ahead = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    velocity = walk.speed(time_s)[:, None] * ahead
    spacing = time_s[1] - time_s[0] if len(time_s) > 1 else 1.0
    acceleration = np.zeros((len(time_s), 3))
    angles = np.zeros((len(time_s), 3))  # yaw, pitch, roll against the heading [rad]
    if len(time_s) > 1:
        acceleration[:, :2] = np.gradient(velocity, spacing, axis=0)
    sway = np.zeros_like(acceleration)  # forward, left, up
    for bout in walk.bouts:
        near = slice(*np.searchsorted(time_s, (bout.span_s[0] - 1, bout.span_s[1] + 1)))
        _step_motion(bout, time_s[near], options.rate_hz, sway[near], angles[near])
    _fidget(options, walk, time_s, sway, angles)
    acceleration[:, 0] += sway[:, 0] * ahead[:, 0] - sway[:, 1] * ahead[:, 1]
    acceleration[:, 1] += sway[:, 0] * ahead[:, 1] + sway[:, 1] * ahead[:, 0]
    acceleration[:, 2] += sway[:, 2]
    angles[:, 0] += heading
    return _Motion(acceleration, Rotation.from_euler("ZYX", angles))


def _step_motion(
    bout: Bout,
    time_s: NDArray[np.float64],
    rate_hz: float,
    sway: NDArray[np.float64],
    angles: NDArray[np.float64],
) -> None:
    """Add a walk's accelerations to ``sway`` (n, 3) and its rotations to ``angles`` (n, 3)."""
    phase = bout.phase(time_s)
    turn = 2 * np.pi * phase
    strength = bout.envelope(time_s)
    # Left steps are even: half a turn of the stride per step, its sine positive on the left leg.
    stride = np.pi * phase
    up = np.sin(turn + 0.5) + 0.45 * np.sin(2 * turn - 0.6)
    forward = np.cos(turn + 0.35) + 0.45 * np.cos(2 * turn + 0.9)
    aside = -np.sin(stride) - 0.35 * np.sin(3 * stride + 0.3)
    sway[:, 0] += 1.1 * strength * forward
    sway[:, 1] += 1.0 * strength * aside
    sway[:, 2] += 2.3 * strength**2 * up
    angles[:, 0] -= 0.07 * strength * np.cos(stride)
    angles[:, 1] += 0.025 * strength * np.cos(turn - 0.6) + 0.05 * strength
    angles[:, 2] += 0.04 * strength * np.sin(stride + 0.4)
    passed = 1 / (1 + (17.0 / (0.4 * rate_hz)) ** 4)  # what the sensor's own low-pass leaves
    for contact_s, strong in zip(bout.contact_s, bout.strength, strict=True):
        near = slice(*np.searchsorted(time_s, (contact_s, contact_s + 0.3)))
        late = time_s[near] - contact_s
        shake = passed * strong * np.sin(2 * np.pi * 17.0 * late) * np.exp(-late / 0.045)
        sway[near] += shake[:, None] * (-1.3, 0.6, 2.0)


def _fidget(
    options: WalkOptions,
    walk: Plan,
    time_s: NDArray[np.float64],
    sway: NDArray[np.float64],
    angles: NDArray[np.float64],
) -> None:
    """Add what a person does who stands: breathe and sway, shift the weight, look round, tap."""
    rng = np.random.default_rng([options.seed, 2])
    for hz in (0.25, 0.6, 1.1):
        swing = np.sin(2 * np.pi * (hz * time_s[:, None] + rng.uniform(0, 1, 3)))
        sway += 0.012 * swing
        angles += 0.004 / (1 + hz) * np.roll(swing, 1, axis=1)
    for start_s, end_s in walk.fidget_s:
        near = slice(*np.searchsorted(time_s, (start_s, end_s)))
        for middle_s in rng.uniform(start_s + 0.4, end_s - 0.4, 5):
            half_s = rng.uniform(0.25, 0.4)
            bump = np.clip(1 - ((time_s[near] - middle_s) / half_s) ** 2, 0, None) ** 2
            sway[near] += bump[:, None] * rng.normal(0, (0.5, 0.7, 0.5))
            angles[near] += bump[:, None] * rng.normal(0, (0.12, 0.04, 0.05))
        late = np.clip(time_s[near] - rng.uniform(start_s + 0.4, end_s - 0.4), 0, None)
        sway[near, 2] += 200 * late * np.exp(-late / 0.02)


def _mount() -> Rotation:
    """Return how the sensor sits on the body."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_euler("ZYX", _MOUNT_DEG, degrees=True)


def _inertial(options: WalkOptions, walk: Plan) -> Samples:
    """Return accelerometer and gyroscope."""
    time_s = _grid(options.duration_s, options.rate_hz)
    motion = _motion(options, walk, time_s)
    sensor = motion.attitude * _mount()
    force = sensor.inv().apply(motion.acceleration + np.array([0.0, 0.0, GRAVITY_MPS2]))
    turning = np.zeros_like(force)
    if len(time_s) > 1:
        turning[:-1] = (sensor[:-1].inv() * sensor[1:]).as_rotvec() * options.rate_hz
        turning[-1] = turning[-2]
    rng = np.random.default_rng([options.seed, 3])
    channels, columns = [], []
    for quantity, prefix, exact in (
        ("acceleration", "acc", force),
        ("angular_velocity", "gyro", turning),
    ):
        noise = _NOISE[quantity] * np.sqrt(options.rate_hz / 100) * rng.standard_normal(exact.shape)
        bias = _BIAS[quantity] * rng.uniform(-1, 1, 3)
        columns.append(np.rint((exact + noise + bias) / _LSB[quantity]) * _LSB[quantity])
        channels += [Channel(f"{prefix}_{a}", quantity, _UNITS[quantity], a) for a in "xyz"]
    stream = Stream("/imu/waist", tuple(channels), options.rate_hz, options.placement)
    return Samples(stream, np.hstack(columns))


def _magnetic(options: WalkOptions, walk: Plan) -> Samples:
    """Return the magnetometer: the earth's field in the sensor's axes, 0.3 uT of noise."""
    rate_hz = min(options.rate_hz / 2, 50.0)
    time_s = _grid(options.duration_s, rate_hz)
    sensor = _motion(options, walk, time_s).attitude * _mount()
    rng = np.random.default_rng([options.seed, 4])
    field = sensor.inv().apply(_FIELD_T) + 0.3e-6 * rng.standard_normal((len(time_s), 3))
    channels = tuple(Channel(f"mag_{a}", "magnetic_field", "T", a) for a in "xyz")
    stream = Stream("/mag/waist", channels, rate_hz, options.placement)
    return Samples(stream, np.rint(field / 1e-8) * 1e-8)


def _pressure(options: WalkOptions) -> Samples:
    """Return the barometer on a level floor: the weather's drift and noise."""
    rate_hz = max(options.rate_hz / 10, 1.0)
    time_s = _grid(options.duration_s, rate_hz)
    rng = np.random.default_rng([options.seed, 5])
    pressure = 100_840.0 + 3.0 * np.sin(time_s / 200.0) + 1.2 * rng.standard_normal(len(time_s))
    stream = Stream(
        "/baro/waist", (Channel("pressure", "pressure", "Pa"),), rate_hz, options.placement
    )
    return Samples(stream, np.rint(pressure / 0.1)[:, None] * 0.1)


def _labels(walk: Plan, duration_s: float) -> tuple[Label, ...]:
    """Return the truth in order of time."""
    time_s = _grid(duration_s, 200.0)
    heading = walk.heading(time_s)
    ahead = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    track = np.ascontiguousarray(np.cumsum(walk.speed(time_s)[:, None] * ahead, axis=0).T) / 200.0

    def at(moment_s: float, kind: str, value: float | None = None, label: str = "") -> Label:
        x, y = (round(float(np.interp(moment_s, time_s, p)), 4) for p in track)
        return Label(_ns(moment_s), kind, None, x, y, value, label=label, author=AUTHOR)

    labels = [at(start + walk.turn_length_s / 2, "waypoint", label="turn") for start in walk.turn_s]
    for bout in walk.bouts:
        start_s, end_s = bout.span_s
        labels += [at(start_s, "waypoint", label="start"), at(end_s, "waypoint", label="stop")]
        labels.append(Label(_ns(start_s), "walking", _ns(end_s), author=AUTHOR))
        for index, contact_s in enumerate(bout.contact_s.tolist()):
            labels.append(at(contact_s, "step", label=("left", "right")[index % 2]))
            course = float(np.interp(contact_s, time_s, heading))
            labels.append(at(contact_s, "heading", value=round(course, 4)))
    return tuple(sorted(labels, key=lambda x: (x.time_ns, x.kind, x.channel)))


def _ns(moment_s: float) -> int:
    return START_NS + round(moment_s * NS_PER_S)
