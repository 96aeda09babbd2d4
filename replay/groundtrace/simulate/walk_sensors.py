"""What the worn sensors record: inertial, magnetic, pressure and satellite positions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import Channel, SignalBlock, Stream
from groundtrace_codecs.units import G0_MPS2

from .body import sensor_motion
from .magnetic import disturbing_field, earth, lap_length_m, through_iron
from .simulation import START_NS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray
    from scipy.spatial.transform import Rotation

    from .body import Motion
    from .gait import Plan
    from .magnetic import Disturbance
    from .person import Person
    from .walk_options import WalkOptions

    Array = NDArray[np.float64]

#: The motion of a band-limited sensor is computed at this rate at least [Hz].
_FINE_HZ = 200.0
_LSB = (8 * G0_MPS2 / 32768, np.radians(1000) / 32768)
#: Where x and y are 0: a car park of the EPFL [deg, deg, m].
_ORIGIN = (46.5197, 6.5657, 400.0)
_EARTH_M = 6_378_137.0
_GNSS_M = (2.0, 0.4)  # wandering with the satellites over a minute, and from fix to fix


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """The samples of one stream, shape (n_samples, n_channels), given a second at a time."""

    stream: Stream
    values: Array

    def __iter__(self) -> Iterator[SignalBlock]:
        size = max(1, round(self.stream.rate_hz))
        for first in range(0, len(self.values), size):
            yield SignalBlock(self.stream, START_NS, first, self.values[first : first + size])


@dataclass(frozen=True, slots=True)
class Walker:
    """Who walks where for how long, as the options ask."""

    options: WalkOptions
    plan: Plan
    who: Person
    duration_s: float
    disturbances: tuple[Disturbance, ...] = ()

    def disturbing_field(self, time_s: Array) -> Array:
        """Return what disturbs the magnetic field at even ``time_s`` (n,) from 0, (n, 3) [T]."""
        along_m = self.plan.progress(time_s)
        return disturbing_field(self.disturbances, along_m, lap_length_m(self.options))

    def samples(self) -> list[Samples]:
        """Return what every sensor records."""
        recorded = [inertial(self), magnetic(self), pressure(self)]
        return [*recorded, gnss(self)] if self.options.gnss else recorded


def grid(duration_s: float, rate_hz: float) -> Array:
    """Return the times of the samples [s], shape (n,)."""
    return np.arange(max(1, round(duration_s * rate_hz))) / rate_hz


def inertial(walker: Walker) -> Samples:
    """Return accelerometer and gyroscope: force and rotation in the sensor's axes."""
    rate_hz = walker.options.rate_hz
    limited = walker.who.sensor.band_limited
    finer = int(np.ceil(_FINE_HZ / rate_hz)) if limited else 1
    count = len(grid(walker.duration_s, rate_hz))
    time_s = np.arange(count * finer) / (rate_hz * finer)
    motion = sensor_motion(walker.options, walker.plan, walker.who, time_s, rate_hz * finer)
    sensor = motion.attitude * _mount(walker.who)
    force = _force(motion, sensor)
    if limited:
        force = _band_limited(force, rate_hz, rate_hz * finer)
    turning = _turning(sensor[::finer], rate_hz)
    values = _imperfect((force[::finer], turning), walker)
    topic = f"/imu/{walker.options.placement}"
    channels = tuple(
        Channel(f"{prefix}_{a}", quantity, unit, a)
        for prefix, quantity, unit in (
            ("acc", "acceleration", "m/s2"),
            ("gyro", "angular_velocity", "rad/s"),
        )
        for a in "xyz"
    )
    return Samples(Stream(topic, channels, rate_hz, walker.options.placement), values)


def _mount(who: Person) -> Rotation:
    """Return how the sensor sits on the body."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_euler("ZYX", who.sensor.mount_deg, degrees=True)


def _force(motion: Motion, sensor: Rotation) -> Array:
    """Return the specific force in the sensor's axes, shape (n, 3) [m/s2]."""
    force: Array = sensor.inv().apply(motion.acceleration + np.array([0.0, 0.0, G0_MPS2]))
    return force


def _turning(sensor: Rotation, rate_hz: float) -> Array:
    """Return the mean angular velocity until the next sample, shape (n, 3) [rad/s]."""
    turning = np.zeros((len(sensor), 3))
    if len(sensor) > 1:
        turning[:-1] = (sensor[:-1].inv() * sensor[1:]).as_rotvec() * rate_hz
        turning[-1] = turning[-2]
    return turning


def _band_limited(force: Array, rate_hz: float, fine_hz: float) -> Array:
    """Return what is left of ``force`` (n, 3) below 0.4 of the sensor's rate, without delay."""
    from scipy.signal import butter, sosfiltfilt

    if len(force) < 30:
        return force
    sos = butter(2, 0.4 * rate_hz, fs=fine_hz, output="sos")
    passed: Array = sosfiltfilt(sos, force, axis=0)
    return passed


def _imperfect(exact: tuple[Array, Array], walker: Walker) -> Array:
    """Return acceleration and angular velocity with noise, biases, scale errors, in counts."""
    sensor, rate_hz = walker.who.sensor, walker.options.rate_hz
    rng = np.random.default_rng([walker.options.seed, 3])
    slow = np.random.default_rng([walker.options.seed, 15])
    columns = []
    for values, noise, bias, wander, lsb in zip(
        exact,
        (sensor.acceleration, sensor.angular_velocity),
        (sensor.acceleration_bias, sensor.angular_velocity_bias),
        (sensor.acceleration_walk, sensor.angular_velocity_walk),
        _LSB,
        strict=True,
    ):
        white = noise * np.sqrt(rate_hz / 100) * rng.standard_normal(values.shape)
        constant = bias * rng.uniform(-1, 1, 3)
        scale = 1 + sensor.scale * slow.standard_normal(3)
        drift = np.cumsum(slow.standard_normal(values.shape), axis=0) * wander / np.sqrt(rate_hz)
        measured = scale * values + drift + white + constant
        columns.append(np.rint(measured / lsb) * lsb)
    return np.hstack(columns)


def magnetic(walker: Walker) -> Samples:
    """Return the magnetometer: the field along the walk in the sensor's axes, and noise."""
    options = walker.options
    rate_hz = min(options.rate_hz / 2, 50.0)
    time_s = grid(walker.duration_s, rate_hz)
    motion = sensor_motion(options, walker.plan, walker.who, time_s, options.rate_hz)
    field = earth(options) + walker.disturbing_field(time_s)
    seen = through_iron((motion.attitude * _mount(walker.who)).inv().apply(field), options)
    rng = np.random.default_rng([options.seed, 4])
    seen = seen + walker.who.sensor.magnetic_t * rng.standard_normal(seen.shape)
    channels = tuple(Channel(f"mag_{a}", "magnetic_field", "T", a) for a in "xyz")
    stream = Stream(f"/mag/{options.placement}", channels, rate_hz, options.placement)
    return Samples(stream, np.rint(seen / 1e-8) * 1e-8)


def pressure(walker: Walker) -> Samples:
    """Return the barometer on a level floor: the weather's drift and noise."""
    options = walker.options
    rate_hz = max(options.rate_hz / 10, 1.0)
    time_s = grid(walker.duration_s, rate_hz)
    rng = np.random.default_rng([options.seed, 5])
    level = 100_840.0 + 3.0 * np.sin(time_s / 200.0) + 1.2 * rng.standard_normal(len(time_s))
    channels = (Channel("pressure", "pressure", "Pa"),)
    stream = Stream(f"/baro/{options.placement}", channels, rate_hz, options.placement)
    return Samples(stream, np.rint(level / 0.1)[:, None] * 0.1)


def gnss(walker: Walker) -> Samples:
    """Return positions once a second: latitude, longitude [deg] and altitude [m] with errors."""
    track = walker.plan.track(grid(walker.duration_s, 100.0))[::100]
    rng = np.random.default_rng([walker.options.seed, 8])
    wander, white = _GNSS_M
    kept = np.exp(-1 / 60.0)
    error = np.empty((len(track), 3))
    now = wander * rng.standard_normal(3)
    for row in error:
        row[:] = now + white * rng.standard_normal(3)
        now = kept * now + wander * np.sqrt(1 - kept**2) * rng.standard_normal(3)
    east, north = (track + error[:, :2]).T
    latitude = _ORIGIN[0] + np.degrees(north / _EARTH_M)
    longitude = _ORIGIN[1] + np.degrees(east / _EARTH_M / np.cos(np.radians(_ORIGIN[0])))
    values = np.stack([latitude, longitude, _ORIGIN[2] + 1.5 * error[:, 2]], axis=1)
    channels = (
        Channel("latitude", "latitude", "deg"),
        Channel("longitude", "longitude", "deg"),
        Channel("altitude", "altitude", "m"),
    )
    return Samples(Stream("/gnss", channels, 1.0), values)
