"""A person walking on a concrete floor under seismic sensors.

The floor is the infinite plate of :mod:`.plate`, a step the force of :mod:`.footfall`: waves are
dispersive and spread without reflections from walls. Steps follow a U through a room of 5.4 m x
5.4 m, the size of the thesis's test room (section 6.2), back and forth, at 0.5 to 0.6 s.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.geometry import Geometry, Medium, Sensor
from groundtrace_codecs.labels import Label
from groundtrace_codecs.signals import NS_PER_S, Channel, SignalBlock, Stream

from ..errors import SimulationError
from .footfall import ArrivalLaw, Footfall
from .plate import Plate, Synthesis
from .simulation import AUTHOR, START_NS, Simulation, described

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

SIDE_M = 5.4
_CORNERS = ((0.7, 0.8), (4.7, 0.8), (4.7, 4.7), (0.7, 4.7))
_FIRST_STEP_S = 0.8
_AFTER_LAST_S = 1.2
_NOISE_COUNTS = 4.0  # of the digitiser: real noise, yet half of every sample compresses away
_HUM = ((50.0, 0.25), (11.0, 0.5))  # frequency [Hz] and amplitude over the noise's deviation


@dataclass(frozen=True, slots=True)
class RoomOptions:
    """What to simulate in the room.

    Attributes
    ----------
    seed
        Of everything that is random.
    duration_s
        Length [s]; None: as long as the steps need.
    channels
        How many sensors, 3 to 16.
    rate_hz
        Sampling rate [Hz], from 1000.
    steps
        How many steps; None: as many as fit in ``duration_s``, or 20.
    snr
        Peak of a mean step at 1 m over the standard deviation of the noise. The default leaves
        about 20 for the weakest step at the farthest of the sensors.
    """

    seed: int = 1
    duration_s: float | None = None
    channels: int = 9
    rate_hz: float = 20_000.0
    steps: int | None = None
    snr: float = 100.0

    def check(self) -> None:
        """Raise SimulationError where an option is out of its range."""
        duration_s = 1.0 if self.duration_s is None else self.duration_s
        limits = (
            ("channels", 3 <= self.channels <= 16, "3 to 16", self.channels),
            ("rate_hz", 1000 <= self.rate_hz <= 1e6, "1000 to 1e6", self.rate_hz),
            ("seed", self.seed >= 0, "0 or more", self.seed),
            ("steps", self.steps is None or self.steps >= 1, "1 or more", self.steps),
            ("snr", self.snr > 0, "more than 0", self.snr),
            ("duration_s", 0 < duration_s < np.inf, "> 0", duration_s),
        )
        for name, good, expected, found in limits:
            if not good:
                raise SimulationError(f"simulate room: {name}: expected {expected}, found {found}")


@dataclass(frozen=True, slots=True)
class _Walker:
    """The steps: times after the first sample (n,) [ns], feet's places (n, 2) [m], footfalls."""

    time_ns: NDArray[np.int64]
    place_m: NDArray[np.float64]
    footfalls: tuple[Footfall, ...]


def simulate_room(options: RoomOptions | None = None) -> Simulation:
    """Simulate a walk through the room.

    The truth: ``step`` with place and foot at each heel's contact, ``pick`` per step and channel
    at the arrival by :class:`.footfall.ArrivalLaw`, and one ``walking`` span.

    Raises
    ------
    SimulationError
        Where an option is out of its range or the steps do not fit in the duration.
    """
    options = options or RoomOptions()
    options.check()
    plate = Plate()
    law = ArrivalLaw.of(plate)
    walker, duration_s = _walk(options)
    geometry = _geometry(options.channels, plate, law)
    places = np.array([(s.x, s.y) for s in geometry.sensors])
    sigma = law.peak_mps / options.snr
    # A step beside a sensor reaches 1.8 times the peak at 1 m: never clip it.
    scale = max(sigma / _NOISE_COUNTS, 2.5 * law.peak_mps / 32767)
    channels = tuple(
        Channel(s.channel, "ground_velocity", "m/s", "z", scale, (s.x, s.y, s.z))
        for s in geometry.sensors
    )
    stream = Stream("/seismic", channels, options.rate_hz)
    signal = RoomSignal(stream, options.seed, duration_s, walker, places, plate, sigma)
    return Simulation(
        sources=[(stream, "i16le", signal)],
        geometry=geometry,
        labels=_labels(walker, geometry, places, law),
        metadata=described("room", options),
    )


def sensor_places(count: int) -> NDArray[np.float64]:
    """Return places of ``count`` sensors, spread in rows over the room, shape (count, 2) [m]."""
    rows = round(np.sqrt(count))
    share = [len(part) for part in np.array_split(np.arange(count), rows)]
    places = []
    for y, n in zip(np.linspace(0, SIDE_M, rows), share, strict=True):
        across = np.linspace(0, SIDE_M, n) if n > 1 else [SIDE_M / 2]
        places += [(x, y) for x in across]
    return np.round(np.array(places), 3)


def _geometry(count: int, plate: Plate, law: ArrivalLaw) -> Geometry:
    places = sensor_places(count).tolist()
    return Geometry(
        sensors=tuple(Sensor(f"G{i}", f"G{i}", x, y) for i, (x, y) in enumerate(places, 1)),
        outline=((0.0, 0.0), (SIDE_M, 0.0), (SIDE_M, SIDE_M), (0.0, SIDE_M)),
        start=_CORNERS[0],
        medium=Medium(plate.thickness_m, law.velocity_mps, law.theta_s),
    )


def _walk(options: RoomOptions) -> tuple[_Walker, float]:
    """Draw the steps and settle the duration [s]."""
    rng = np.random.default_rng([options.seed, 1])
    wanted = options.steps or (20 if options.duration_s is None else int(options.duration_s / 0.5))
    gaps = np.clip(rng.normal(0.55, 0.025, wanted), 0.5, 0.6)
    time_s = _FIRST_STEP_S + np.concatenate(([0.0], np.cumsum(gaps[1:])))
    duration_s = options.duration_s or float(np.ceil(time_s[-1] + _AFTER_LAST_S))
    fitting = int(np.count_nonzero(time_s < duration_s - _AFTER_LAST_S / 2))
    if fitting < (options.steps or 1):
        raise SimulationError(
            f"simulate room: steps: expected {fitting} or fewer in {duration_s:g} s, "
            f"found {options.steps or 1}"
        )
    run_m = np.cumsum(rng.normal(0.58, 0.02, wanted))
    walker = _Walker(
        time_ns=np.rint(time_s[:fitting] * NS_PER_S).astype(np.int64),
        place_m=_feet(run_m[:fitting] - run_m[0]),
        footfalls=tuple(Footfall.drawn(rng) for _ in range(fitting)),
    )
    return walker, duration_s


def _feet(run_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the feet's places after ``run_m`` metres of path, left foot first, shape (n, 2)."""
    path = np.array(_CORNERS)
    for _ in range(4):  # Chaikin's corner cutting
        inner = np.stack([0.75 * path[:-1] + 0.25 * path[1:], 0.25 * path[:-1] + 0.75 * path[1:]])
        path = np.concatenate([path[:1], inner.transpose(1, 0, 2).reshape(-1, 2), path[-1:]])
    legs = np.diff(path, axis=0)
    length = np.hypot(*legs.T)
    along = np.concatenate(([0.0], np.cumsum(length)))
    phase = run_m % (2 * along[-1])
    back = phase > along[-1]
    arc = np.where(back, 2 * along[-1] - phase, phase)
    leg = np.clip(np.searchsorted(along, arc, side="right") - 1, 0, len(legs) - 1)
    heading = legs[leg] / length[leg, None] * np.where(back, -1.0, 1.0)[:, None]
    middle = np.stack([np.interp(arc, along, path[:, axis]) for axis in (0, 1)], axis=1)
    left = np.stack([-heading[:, 1], heading[:, 0]], axis=1)
    aside = np.where(np.arange(len(run_m)) % 2 == 0, 0.07, -0.07)
    feet: NDArray[np.float64] = np.round(middle + aside[:, None] * left, 4)
    return feet


def _labels(
    walker: _Walker, geometry: Geometry, places: NDArray[np.float64], law: ArrivalLaw
) -> tuple[Label, ...]:
    """Return the truth in order of time."""
    start_ns = int(walker.time_ns[0]) + START_NS - NS_PER_S // 4
    end_ns = int(walker.time_ns[-1]) + START_NS + NS_PER_S // 4
    labels = [Label(start_ns, "walking", end_ns, author=AUTHOR)]
    for index, (time_ns, (x, y)) in enumerate(
        zip((walker.time_ns + START_NS).tolist(), walker.place_m.tolist(), strict=True)
    ):
        foot = ("left", "right")[index % 2]
        labels.append(Label(time_ns, "step", x_m=x, y_m=y, label=foot, author=AUTHOR))
        arrival_s = law(np.hypot(*(places - (x, y)).T))
        for sensor, delay_ns in zip(geometry.sensors, arrival_s * NS_PER_S, strict=True):
            arrival_ns = time_ns + round(delay_ns)
            labels.append(Label(arrival_ns, "pick", channel=sensor.channel, author=AUTHOR))
    return tuple(sorted(labels, key=lambda x: (x.time_ns, x.kind, x.channel)))


@dataclass(frozen=True, slots=True)
class RoomSignal:
    """The samples of a room, generated a second at a time; iterating again gives the same.

    Attributes
    ----------
    stream
        Its channels share one scale: counts of a digitiser.
    seed
        Of the noise.
    duration_s
        Length [s].
    walker
        The steps.
    places
        Of the sensors, shape (n_channels, 2) [m].
    plate
        The floor.
    sigma_mps
        Mean standard deviation of the noise [m/s]; each channel has 0.8 to 1.2 of it.
    """

    stream: Stream
    seed: int
    duration_s: float
    walker: _Walker
    places: NDArray[np.float64]
    plate: Plate
    sigma_mps: float

    def __iter__(self) -> Iterator[SignalBlock]:
        rate = self.stream.rate_hz
        total, size = round(self.duration_s * rate), round(rate)
        synthesis = Synthesis.lasting(self.plate, rate, 0.4)
        sensor = synthesis.sensor()
        noise = self._noise()
        pending = np.zeros((size + synthesis.samples, len(self.places)))
        step = 0
        for first in range(0, total, size):
            # A waveform starts a few samples early: band-limited, it rings before its onset.
            while step < len(self.walker.time_ns) and self._lead(step) < first + size:
                pending_from = self._lead(step) - first
                waves = self._waves(step, synthesis, sensor)
                pending[pending_from : pending_from + synthesis.samples] += waves
                step += 1
            count = min(size, total - first)
            counts = (pending[:count] + next(noise)[:count]) / self.stream.scales
            samples = np.clip(np.rint(counts), -32768, 32767).astype(np.int16)
            yield SignalBlock(self.stream, START_NS, first, samples)
            pending[: synthesis.samples] = pending[size:].copy()
            pending[synthesis.samples :] = 0.0

    def _lead(self, step: int) -> int:
        """Return the sample at which the waveforms of ``step`` start."""
        return int(self.walker.time_ns[step] * self.stream.rate_hz // NS_PER_S) - 16

    def _waves(
        self, step: int, synthesis: Synthesis, sensor: NDArray[np.complex128]
    ) -> NDArray[np.float64]:
        """Return what all channels see of ``step``, shape (n_samples, n_channels) [m/s]."""
        frequency = synthesis.frequency_hz
        delay_s = self.walker.time_ns[step] / NS_PER_S - self._lead(step) / self.stream.rate_hz
        force = self.walker.footfalls[step].spectrum(frequency) * sensor
        force *= np.exp(-2j * np.pi * delay_s * frequency)
        distance = np.hypot(*(self.places - self.walker.place_m[step]).T)
        return synthesis.waveforms(distance, force).T

    def _noise(self) -> Iterator[NDArray[np.float64]]:
        """Give a second of white noise and hum at a time, shape (n_samples, n_channels) [m/s]."""
        rng = np.random.default_rng([self.seed, 2])
        n_channels, size = len(self.places), round(self.stream.rate_hz)
        level = self.sigma_mps * rng.uniform(0.8, 1.2, n_channels)
        phase = rng.uniform(0, 2 * np.pi, (len(_HUM), n_channels))
        first = 0
        while True:
            time_s = (first + np.arange(size)) / self.stream.rate_hz
            noise = rng.standard_normal((size, n_channels))
            for (hum_hz, amplitude), angle in zip(_HUM, phase, strict=True):
                turn = 2 * np.pi * hum_hz * time_s
                noise += amplitude * (
                    np.outer(np.sin(turn), np.cos(angle)) + np.outer(np.cos(turn), np.sin(angle))
                )
            yield noise * level
            first += size
