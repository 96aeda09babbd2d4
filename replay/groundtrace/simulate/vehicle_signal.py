"""The samples of sensors beside a road: vehicles, walkers, wind, noise, the digitiser.

A vehicle makes noise of engine and tyres whose band moves, and engine orders. Its ground motion is
an analytic signal: the real part moves the ground up, the imaginary part is the same a quarter of a
period later, which a Rayleigh wave's horizontal motion and fading need.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import SignalBlock, Stream

from ..vehicles.medium import Geophone, PowerLaw, loss_per_m
from .recording import START_NS
from .road import DRAWN_MPS, LASTS_S, SPEED_MPS, Drive, Road, middle_of, road_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.geometry import Geometry

    from .road import VehicleOptions

    Array = NDArray[np.float64]
    Complex = NDArray[np.complex128]

#: Chosen by judgement: exp(-12) is below the noise; wind shakes below the band of vehicles, and its
#: level by a factor of 1.6.
_LASTS = 12.0  # times its decay that a burst is computed for
_WIND_HZ = (0.5, 8.0)
_GUST = 0.5  # standard deviation of the logarithm of the wind's level


@dataclass(frozen=True, slots=True, eq=False)
class RoadSignal:
    """The samples beside a road, generated a second at a time; iterating again gives the same.

    Attributes
    ----------
    stream
        Its channels' scales are counts of a digitiser.
    seed
        Of noise and wind.
    duration_s
        Length [s].
    vehicles, sources
        Who drives by, and the noise of each.
    bursts
        In order of time.
    ground, channels
        What the waves run through, and who feels them.
    sigma_mps, wind_mps
        Standard deviations of noise (each channel has 0.8 to 1.2 of it) and of wind [m/s].
    gains
        Of each channel, shape (n_channels,).
    geophone_hz
        Natural frequency of the sensors, or None.
    """

    stream: Stream
    seed: int
    duration_s: float
    vehicles: Sequence[Vehicle]
    sources: Sequence[Source]
    bursts: Sequence[Burst]
    ground: Ground
    channels: Channels
    sigma_mps: float
    wind_mps: float
    gains: Array
    geophone_hz: float | None

    def __iter__(self) -> Iterator[SignalBlock]:
        rate = self.stream.rate_hz
        total, size = round(self.duration_s * rate), round(rate)
        pairs = zip(self.vehicles, self.sources, strict=True)
        waves = [Waves(v, source, self.ground, self.channels) for v, source in pairs]
        noise, wind, sense = self._noise(), self._wind(), self._sensing()
        for first in range(0, total, size):
            time_s = (first + np.arange(size)) / rate
            moved = wind.samples(first, size).real.copy()
            for one in waves:
                if one.lasts(time_s):
                    moved += one.response(time_s)
            for burst in self._bursts_during(time_s):
                moved += burst_felt(burst, time_s, self.ground, self.channels)
            measured = (sense(moved) + next(noise)) * self.gains
            counts = np.rint(measured[: total - first] / self.stream.scales)
            samples = np.clip(counts, -32768, 32767).astype(np.int16)
            yield SignalBlock(self.stream, START_NS, first, samples)

    def _bursts_during(self, time_s: Array) -> list[Burst]:
        """Return the bursts that any station may feel in a block."""
        places = self.channels.places
        bursts = []
        for burst in self.bursts:
            farthest_m = np.hypot(*(places - (burst.x_m, burst.y_m)).T).max()
            over_s = burst.time_s + farthest_m / self.ground.velocity_mps + _LASTS * burst.decay_s
            if burst.time_s <= time_s[-1] and over_s >= time_s[0]:
                bursts.append(burst)
        return bursts

    def _noise(self) -> Iterator[Array]:
        """Give a second of white noise at a time, shape (n_samples, n_channels) [m/s]."""
        rng = np.random.default_rng([self.seed, 3])
        n_channels, size = len(self.stream.channels), round(self.stream.rate_hz)
        level = self.sigma_mps * rng.uniform(0.8, 1.2, n_channels)
        while True:
            yield rng.standard_normal((size, n_channels)) * level

    def _wind(self) -> Frames:
        """Return wind, one column a channel; its real part moves the sensors [m/s].

        Its density of power falls with frequency, and its gusts are those of all channels.
        """
        rate, n_channels = self.stream.rate_hz, len(self.stream.channels)
        count = 2 * round(rate)
        f = np.arange(count // 2) * rate / count
        density = band(f, *_WIND_HZ) / np.maximum(f, _WIND_HZ[0])
        line = self.wind_mps * np.sqrt(density / density.sum())

        def draw(number: int) -> Complex:
            rng = np.random.default_rng([self.seed, 4, number + BEFORE])
            gust = np.exp(_GUST * rng.standard_normal() - _GUST**2)
            drawn = rng.standard_normal((2, len(f), n_channels))
            spectrum = gust * line[:, None] * (drawn[0] + 1j * drawn[1])
            frame: Complex = np.fft.ifft(spectrum, count, axis=0) * count
            return frame

        return Frames(round(rate), draw)

    def _sensing(self) -> Callable[[Array], Array]:
        """Return what makes the sensors' signal of the ground's velocity, piece after piece.

        A bilinear transform of the geophone's high-pass, exact at its natural frequency.
        """
        if self.geophone_hz is None:
            return lambda moved: moved
        from scipy.signal import lfilter

        numerator, denominator = sampled(Geophone(self.geophone_hz), self.stream.rate_hz)
        state = np.zeros((2, len(self.stream.channels)))

        def sense(moved: Array) -> Array:
            nonlocal state
            sensed, state = lfilter(numerator, denominator, moved, axis=0, zi=state)
            velocity: Array = sensed
            return velocity

        return sense


def sampled(geophone: Geophone, rate_hz: float) -> tuple[Array, Array]:
    """Return the filter of samples that a high-pass geophone is, numerator and denominator."""
    warped = np.tan(np.pi * geophone.natural_hz / rate_hz)
    damped = 2 * geophone.damping * warped
    numerator = np.array([1.0, -2.0, 1.0])
    denominator = np.array(
        [1 + damped + warped**2, 2 * warped**2 - 2, 1 - damped + warped**2], np.float64
    )
    return numerator / denominator[0], denominator / denominator[0]


#: By how much of itself the noise's band moves up and down. Chosen by judgement: a vehicle's
#: spectrum is not the same twice.
WANDER = 0.15
#: Parts of the band that are damped each for itself, where the ground has loss: the mean power is
#: within 3 % of an integral's, as long as the loss takes less than 20 dB. Chosen by judgement.
PARTS = 16
#: Frames before time 0 that may be asked for: a seed is never negative. Chosen by judgement: more
#: than any recording has.
BEFORE = 1 << 20
#: Chosen by judgement: soft edges ring little; an engine of four strokes; more samples of a
#: sinc cost more than they say.
_EDGE = 0.2  # of the band's width, over which it begins and ends
_ORDERS = np.array([0.5, 0.25, 0.15, 0.1])  # parts of the engine's power at multiples of its rate
_SWING_S, _SWING = 7.0, 0.02  # by what part the engine's rate swings, and how slowly
_SIDE, _ROWS = 16, 1024  # samples on either side of a place between two; places between two
_TAPS = np.arange(1 - _SIDE, _SIDE + 1)


@dataclass(slots=True, eq=False)
class Frames:
    """Noise of any length out of frames of two seconds that overlap by half.

    Frames are independent and fade in and out by a sine, so that powers add up to a constant, and
    each is drawn by its number: any piece can be had in any order.

    Attributes
    ----------
    hop
        Samples from frame to frame; a frame has twice as many.
    draw
        Returns frame ``number`` of the noise, shape (2 hop, n_columns).
    """

    hop: int
    draw: Callable[[int], NDArray[np.complex128]]
    _frames: dict[int, Complex] = field(default_factory=dict, init=False)

    def samples(self, first: int, count: int) -> Complex:
        """Return ``count`` samples from sample ``first``, which may be negative."""
        low, high = first // self.hop - 1, (first + count - 1) // self.hop
        frames = {
            k: self._frames[k] if k in self._frames else self._faded(k)
            for k in range(low, high + 1)
        }
        self._frames = frames
        columns = frames[low].shape[1]
        total = np.zeros(((high - low + 2) * self.hop, columns), np.complex128)
        for k, frame in frames.items():
            total[(k - low) * self.hop : (k - low + 2) * self.hop] += frame
        start = first - low * self.hop
        return total[start : start + count]

    def _faded(self, number: int) -> Complex:
        fade = np.sin(np.pi * (np.arange(2 * self.hop) + 0.5) / (2 * self.hop))
        return self.draw(number) * fade[:, None]


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """A vehicle's noise of unit power, in parts by frequency.

    Attributes
    ----------
    rate_hz
        Of its samples.
    band_hz
        Lower and upper edge, at half its power.
    parts
        Parts of the band.
    engine_hz
        Rate of the engine's firing, or None for a vehicle without tones.
    engine_share
        Part of the power that is the engine's tones.
    seed
        Of this vehicle.
    """

    rate_hz: float
    band_hz: tuple[float, float]
    parts: int
    engine_hz: float | None
    engine_share: float
    seed: tuple[int, ...]

    def frequencies_hz(self) -> Array:
        """Return the frequency that stands for each part, tones last, shape (n,)."""
        edges = self._edges()
        parts: Array = np.append((edges[1:] + edges[:-1]) / 2, self._tones_hz())
        return parts

    def frames(self) -> Frames:
        """Return the noise of the band, one column a part; tones are not in it."""
        return Frames(round(self.rate_hz), self._frame)

    def tones(self, time_s: Array) -> Complex:
        """Return the engine's tones at times, shape (len(time_s), n_tones)."""
        tones_hz = self._tones_hz()
        if not len(tones_hz):
            return np.empty((len(time_s), 0), np.complex128)
        phase = np.random.default_rng([*self.seed, 1]).uniform(0, 2 * np.pi, len(tones_hz) + 1)
        swing = _SWING * _SWING_S * np.sin(2 * np.pi * time_s / _SWING_S + phase[-1]) / (2 * np.pi)
        turns = np.multiply.outer(time_s + swing, tones_hz)
        share = _ORDERS[: len(tones_hz)] / _ORDERS[: len(tones_hz)].sum()
        amplitude = np.sqrt(2 * self.engine_share * share)
        tones: Complex = amplitude * np.exp(2j * np.pi * turns + 1j * phase[:-1])
        return tones

    def _tones_hz(self) -> Array:
        if self.engine_hz is None:
            return np.empty(0)
        tones: Array = self.engine_hz * np.arange(1, len(_ORDERS) + 1, dtype=np.float64)
        return tones[tones <= 0.35 * self.rate_hz]

    def _edges(self) -> Array:
        low, high = self.band_hz
        edge = _EDGE * (high - low) / 2
        lowest, highest = (low - edge) * (1 - WANDER), (high + edge) * (1 + WANDER)
        edges: Array = np.linspace(lowest, highest, self.parts + 1)
        return edges

    def _frame(self, number: int) -> Complex:
        rng = np.random.default_rng([*self.seed, 0, number + BEFORE])
        count = 2 * round(self.rate_hz)
        f = np.arange(count // 2) * self.rate_hz / count
        density = band(f / rng.uniform(1 - WANDER, 1 + WANDER), *self.band_hz)
        noise = 1.0 - (self.engine_share if len(self._tones_hz()) else 0.0)
        density *= noise / density.sum()
        drawn = rng.standard_normal((2, len(f)))
        line = np.sqrt(density) * (drawn[0] + 1j * drawn[1])
        part = np.clip(np.searchsorted(self._edges(), f, side="right") - 1, 0, self.parts - 1)
        spectrum = np.zeros((count, self.parts), np.complex128)
        spectrum[np.arange(len(f)), part] = line
        frame: Complex = np.fft.ifft(spectrum, axis=0) * count
        return frame


def band(frequency_hz: Array, low_hz: float, high_hz: float) -> Array:
    """Return a density of power: 1 in a band, falling by a cosine over a fifth of its width."""
    edge = _EDGE * (high_hz - low_hz)
    rise = np.clip((frequency_hz - low_hz) / edge + 0.5, 0, 1)
    fall = np.clip((high_hz - frequency_hz) / edge + 0.5, 0, 1)
    density: Array = np.sin(np.pi / 2 * rise) ** 2 * np.sin(np.pi / 2 * fall) ** 2
    return density


def between(samples: Complex, position: Array) -> Complex:
    """Return band-limited samples at positions between them.

    A sinc under a Blackman window of 32 samples: 1e-3 of the amplitude off at most, up to 0.4 of
    the sampling rate.

    Parameters
    ----------
    samples
        Shape (n, n_columns).
    position
        In samples, each :func:`margin` at least from either end; any shape.

    Returns
    -------
    Shape (..., n_columns).
    """
    base = np.floor(position).astype(np.intp)
    row = (position - base) * _ROWS
    before = row.astype(np.intp)
    part = (row - before)[..., None]
    weight = (1 - part) * _weights()[before] + part * _weights()[before + 1]
    near = samples[base[..., None] + _TAPS]
    interpolated: Complex = np.einsum("...k,...kp->...p", weight, near)
    return interpolated


@lru_cache
def _weights() -> Array:
    """Return the weights of samples, a row for each place between two, shape (rows + 1, 32)."""
    off = np.arange(_ROWS + 1)[:, None] / _ROWS - _TAPS
    turn = np.pi * off / _SIDE
    weights: Array = np.sinc(off) * (0.42 + 0.5 * np.cos(turn) + 0.08 * np.cos(2 * turn))
    return weights


def margin() -> int:
    """Return how many samples :func:`between` needs on either side."""
    return _SIDE + 1


#: Root of the mean power of a mean vehicle at 1 m [m/s]. Chosen by judgement: as geophones beside a
#: road give; people, impacts and lanes of usual ways about it.
LEVEL_MPS = 5e-5
_LANE_M = 1.75  # of each lane's middle from the road's line, where there are several vehicles
_SPREAD_DB = 3.0
_JITTER = 0.25  # of the time between two passes, by which each is early or late
_OVERLAP_S = (0.5, 2.0)
_PACE_HZ, _WALK_MPS = 1.8, 1.4
_WALK_S = 20.0
_STEP, _IMPACT = 1.0, 4.0  # peak at 1 m over a mean vehicle's level
_AROUND_M = 15.0  # impacts lie so far from the middle of the sensors at most


@dataclass(frozen=True, slots=True, eq=False)
class Vehicle:
    """One vehicle.

    Attributes
    ----------
    name
        ``V1`` and so on, in order of passing.
    drive
        Its way.
    mu
        Its energy parameter [(m/s)^2 m^n].
    seed
        Of its noise and its fading.
    """

    name: str
    drive: Drive
    mu: float
    seed: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Burst:
    """A blow on the ground: a decaying swing.

    Attributes
    ----------
    time_s
        After the first sample [s].
    x_m, y_m
        Place [m].
    peak_mps
        About the largest velocity at 1 m [m/s].
    frequency_hz, decay_s
        Of the swing.
    target
        Whose step; empty for an impact.
    """

    time_s: float
    x_m: float
    y_m: float
    peak_mps: float
    frequency_hz: float
    decay_s: float
    target: str = ""


def vehicles_of(options: VehicleOptions, site: Geometry) -> tuple[Vehicle, ...]:
    """Draw the vehicles, in order of passing the middle of the sensors."""
    rng = np.random.default_rng([options.seed, 1])
    road, middle = road_of(options, site), middle_of(site)
    times, forward = _times(options, rng)
    spread_db = options.level_spread_db
    if spread_db is None:
        spread_db = 0.0 if options.passes == 1 else _SPREAD_DB
    vehicles = []
    for number, (time_s, ahead) in enumerate(zip(times, forward, strict=True), 1):
        lane = road if options.passes == 1 else road.beside(-_LANE_M if ahead else _LANE_M)
        speed_mps = options.speed_mps or _drawn_mps(options, rng)
        drive = Drive(
            lane,
            pass_s=time_s,
            along_m=lane.nearest_m(middle),
            knots_s=(0.0, options.length_s),
            speeds_mps=(speed_mps, options.end_speed_mps or speed_mps),
            forward=ahead,
        )
        mu = LEVEL_MPS**2 * 10 ** (spread_db * rng.standard_normal() / 10)
        vehicles.append(Vehicle(f"V{number}", drive, mu, (options.seed, 11, number)))
    return tuple(vehicles)


def _drawn_mps(options: VehicleOptions, rng: np.random.Generator) -> float:
    return SPEED_MPS if options.passes == 1 else round(float(rng.uniform(*DRAWN_MPS)), 2)


def _times(options: VehicleOptions, rng: np.random.Generator) -> tuple[list[float], list[bool]]:
    """Return when each vehicle passes the middle [s], in order, and whether it goes forward."""
    length_s, count = options.length_s, options.passes
    if count == 1:
        return [length_s / 2], [True]
    slot_s = length_s / count
    times = (np.arange(count) + 0.5 + rng.uniform(-_JITTER, _JITTER, count)) * slot_s
    forward = rng.permutation(np.arange(count) % 2 == 0)
    if options.overlap:
        times[1] = times[0] + min(rng.uniform(*_OVERLAP_S), slot_s / 2)
        rest = rng.permutation(np.arange(count - 2) % 2 == 0)
        forward = np.concatenate([[True, False], rest])
    return [float(t) for t in times], [bool(f) for f in forward]


def bursts_of(options: VehicleOptions, site: Geometry) -> tuple[Burst, ...]:
    """Draw steps of people who walk by and single impacts, in order of time."""
    rng = np.random.default_rng([options.seed, 2])
    bursts = [b for n in range(options.walkers) for b in _walk(options, site, f"W{n + 1}", rng)]
    bursts += [_impact(options, site, rng) for _ in range(options.impacts)]
    return tuple(sorted(bursts, key=lambda b: (b.time_s, b.target)))


def _walk(
    options: VehicleOptions, site: Geometry, name: str, rng: np.random.Generator
) -> list[Burst]:
    """Walk straight by the middle of the sensors at 1.8 steps a second."""
    half_s = min(_WALK_S, options.length_s / 2) / 2
    when_s = rng.uniform(half_s, options.length_s - half_s)
    heading = rng.uniform(0, 2 * np.pi)
    aside = rng.uniform(-5.0, 5.0) * np.array([-np.sin(heading), np.cos(heading)])
    path = Road.straight(middle_of(site) + aside, heading)
    times = np.arange(when_s - half_s, when_s + half_s, 1 / _PACE_HZ)
    times += rng.normal(0, 0.02, len(times))
    level = LEVEL_MPS * _STEP * rng.uniform(0.8, 1.25)
    places = path.places(_WALK_MPS * (times - when_s))
    return [
        _burst(options, t, position, level * rng.uniform(0.85, 1.15), rng, name)
        for t, position in zip(times, places, strict=True)
        if 0 <= t < options.length_s
    ]


def _impact(options: VehicleOptions, site: Geometry, rng: np.random.Generator) -> Burst:
    angle, away_m = rng.uniform(0, 2 * np.pi), _AROUND_M * np.sqrt(rng.random())
    position = middle_of(site) + away_m * np.array([np.cos(angle), np.sin(angle)])
    time_s = rng.uniform(0, options.length_s)
    return _burst(options, time_s, position, LEVEL_MPS * _IMPACT * rng.uniform(0.6, 1.6), rng)


def _burst(
    options: VehicleOptions,
    time_s: float,
    position: np.ndarray[tuple[int, ...], np.dtype[np.float64]],
    peak_mps: float,
    rng: np.random.Generator,
    target: str = "",
) -> Burst:
    frequency_hz = min(rng.uniform(20.0, 35.0), 0.25 * options.rate_hz)
    x, y = (float(v) for v in position)
    return Burst(float(time_s), x, y, peak_mps, frequency_hz, rng.uniform(0.03, 0.06), target)


#: Radial over vertical movement of a Rayleigh wave at the surface. Source: Rayleigh's equation:
#: 0.68 and 0.64 at Poisson's ratios of 0.25 and 0.33.
RADIAL = 0.65
#: Chosen by judgement: a sum of so many is Gaussian; it fades long before it is off the road.
_SCATTERERS = 32  # paths that make the fading of one vehicle at one station
_FULL_S = 150.0  # before and after its pass, a vehicle begins to fade away


@dataclass(frozen=True, slots=True, eq=False)
class Channels:
    """What each channel feels; stations have one place each.

    Attributes
    ----------
    places
        Of the stations, shape (n_stations, 2) [m].
    station
        Of each channel, shape (n_channels,).
    axes
        ``x``, ``y`` or ``z`` of each channel.
    """

    places: Array
    station: NDArray[np.intp]
    axes: tuple[str, ...]

    def response(self, waves: Complex, away: Array) -> Array:
        """Return what channels feel of retrograde Rayleigh waves.

        Parameters
        ----------
        waves
            Vertical motion at each station, analytic, shape (n, n_stations).
        away
            From the source to the station, shape (n, n_stations, 2) [m].

        Returns
        -------
        Shape (n, n_channels).
        """
        response = waves.real[:, self.station].copy()
        flat = [i for i, axis in enumerate(self.axes) if axis != "z"]
        if flat:
            unit = away / np.maximum(np.linalg.norm(away, axis=-1, keepdims=True), 1e-9)
            part = np.array(["xy".index(self.axes[i]) for i in flat])
            at = self.station[flat]
            response[:, flat] = -RADIAL * waves.imag[:, at] * unit[:, at, part]
        return response


@dataclass(frozen=True, slots=True)
class Ground:
    """What the waves run through.

    Attributes
    ----------
    velocity_mps
        Of the waves.
    exponent, loss_spm
        n and rho of the law of power, :class:`~.vehicles.medium.PowerLaw`.
    coherence_m
        Way over which fading changes, or None without fading.
    """

    velocity_mps: float
    exponent: float
    loss_spm: float = 0.0
    coherence_m: float | None = None

    def amplitude(self, distance_m: Array, mu: float, frequency_hz: float) -> Array:
        """Return the root of the mean power at distances of any shape."""
        law = PowerLaw(mu, self.exponent, loss_per_m(self.loss_spm, frequency_hz))
        return np.sqrt(law.power(distance_m))


class Waves:
    """The waves of one vehicle at all stations, in pieces that follow each other."""

    def __init__(self, vehicle: Vehicle, source: Source, ground: Ground, channels: Channels):
        self.vehicle, self.source, self.ground, self.channels = vehicle, source, ground, channels
        self._frames = source.frames()
        self._fading = Fading.drawn(ground, len(channels.places), vehicle.seed)

    def lasts(self, time_s: Array) -> bool:
        """Return whether the vehicle is on the road at any of the times."""
        return bool(np.abs(time_s - self.vehicle.drive.pass_s).min() < LASTS_S)

    def response(self, time_s: Array) -> Array:
        """Return what all channels feel at evenly spaced times, shape (n, n_channels) [m/s]."""
        drive, velocity = self.vehicle.drive, self.ground.velocity_mps
        places = self.channels.places
        emitted = drive.emitted_s(time_s, places, velocity)
        away = places - drive.places(emitted)
        distance = np.hypot(away[..., 0], away[..., 1])
        parts = np.concatenate([self._noise(emitted), self._tones(emitted)], axis=-1)
        waves = np.zeros(emitted.shape, np.complex128)
        for part, frequency_hz in enumerate(self.source.frequencies_hz()):
            amplitude = self.ground.amplitude(distance, self.vehicle.mu, float(frequency_hz))
            waves += amplitude * parts[..., part]
        waves *= self._fading.gain(drive.travelled(emitted))
        waves *= _there(time_s - drive.pass_s)[:, None]
        return self.channels.response(waves, away)

    def _noise(self, emitted_s: Array) -> Complex:
        position = emitted_s * self.source.rate_hz
        first = int(np.floor(position.min())) - margin()
        last = int(np.ceil(position.max())) + margin()
        return between(self._frames.samples(first, last - first + 1), position - first)

    def _tones(self, emitted_s: Array) -> Complex:
        tones = self.source.tones(emitted_s.ravel())
        return tones.reshape(*emitted_s.shape, tones.shape[1])


def _there(since_s: Array) -> Array:
    """Return 1 for minutes about a pass and 0 beyond: who is a long way off costs no time."""
    part = np.clip((LASTS_S - np.abs(since_s)) / (LASTS_S - _FULL_S), 0, 1)
    there: Array = part**2 * (3 - 2 * part)
    return there


@dataclass(frozen=True, slots=True, eq=False)
class Fading:
    """Multipath: a factor that wanders as the vehicle goes, another at each station.

    It is the sum of many paths whose phases turn with the way, so that a signal's envelope is
    Rayleigh's and its momentary power exponential, as the paper has it before its equation (10);
    the mean power stays. Over a way d the factor correlates with itself by exp(-d^2 / 2 D^2).

    Attributes
    ----------
    turn_radpm, phase_rad
        Of each path at each station, shape (n_stations, n_paths), or None without fading.
    """

    turn_radpm: Array | None
    phase_rad: Array | None

    @classmethod
    def drawn(cls, ground: Ground, stations: int, seed: tuple[int, ...]) -> Fading:
        """Draw the paths of one vehicle to each station."""
        if ground.coherence_m is None:
            return cls(None, None)
        rng = np.random.default_rng([*seed, 2])
        shape = (stations, _SCATTERERS)
        return cls(rng.normal(0, 1 / ground.coherence_m, shape), rng.uniform(0, 2 * np.pi, shape))

    def gain(self, way_m: Array) -> Complex:
        """Return the factors where the vehicle has gone ``way_m``, shape (n, n_stations)."""
        if self.turn_radpm is None or self.phase_rad is None:
            return np.ones(way_m.shape, np.complex128)
        paths = np.exp(1j * (self.turn_radpm * way_m[..., None] + self.phase_rad))
        gain: Complex = paths.sum(axis=-1) / np.sqrt(_SCATTERERS)
        return gain


def burst_felt(burst: Burst, time_s: Array, ground: Ground, channels: Channels) -> Array:
    """Return what all channels feel of a burst, shape (n, n_channels) [m/s]."""
    away = channels.places - (burst.x_m, burst.y_m)
    distance = np.linalg.norm(away, axis=-1)
    late = time_s[:, None] - burst.time_s - distance / ground.velocity_mps
    after = np.maximum(late, 0.0)
    peak = burst.peak_mps * ground.amplitude(distance, 1.0, burst.frequency_hz)
    swing = -1j * np.exp((2j * np.pi * burst.frequency_hz - 1 / burst.decay_s) * after)
    waves = np.where(late > 0, peak * swing, 0.0)
    return channels.response(waves, np.broadcast_to(away, (len(time_s), *away.shape)))
