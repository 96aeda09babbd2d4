"""Shots on a line of geophones: first arrivals, what follows them, and what spoils them.

Ground of flat layers carries the direct wave and the waves refracted along each deeper layer (W. M.
Telford, L. P. Geldart, R. E. Sheriff, Applied Geophysics, 1990, section 4.3), reflections, surface
waves that disperse, and sound in the air. Each loses high frequencies by a constant Q (E.
Kjartansson, J. Geophys. Res. 84, 1979, with the phase of a causal loss). Everything else is of the
field: statics, coherent noise before the shot, rumble, hum, bursts, cross-talk of the trigger, late
triggers, dead and flipped traces, stacks. Nothing here knows how arrivals are picked.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from groundtrace_codecs.events import Label
from groundtrace_codecs.geometry import Geometry, Sensor
from groundtrace_codecs.signals import NS_PER_S, Channel, SignalBlock, Stream

from ..errors import SimulationError
from .recording import AUTHOR, START_NS, Simulation, described

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Rng = np.random.Generator

SourceName = Literal["hammer", "drop"]

#: Waves are made at no lower rate than this, up to a frequency, then sampled [Hz]. Chosen by
#: judgement: far above what geophones and ground let through.
FINE_HZ, HIGHEST_HZ = 8000.0, 3000.0
#: An arrival begins where the wave alone, without noise, first reaches this part of the largest
#: swing in the first so many seconds. Chosen by judgement: what the eye tells from nothing.
BEGINS, SWING_S = 0.02, 0.015
#: Records are so far apart [s]. Chosen by judgement: less than a crew needs.
APART_S = 10.0
#: Volts of a count, and the largest count. Source: definition, 24 bits over 2 V.
VOLTS, FULL = 2.0 / 2**23, 2**23 - 1
#: Waves are looked at so long before a shot [s]. Chosen by judgement: whatever rings is seen.
_AHEAD_S = 0.02
#: How many echoes follow a wave. Chosen by judgement: one in 4 ms.
_ECHOES = 20
#: Arrivals whose swing is so many deviations of the noise are truth: nobody reads lesser ones off a
#: trace. Chosen by judgement.
SEEN = 2.0
#: Speed of sound in air [m/s]. Source: definition, dry air at 15 degrees.
AIR_MPS = 340.0
#: Natural frequency of the geophones lies between [Hz], their damping. Chosen by judgement: usual
#: makes.
NATURAL_HZ, DAMPING = (4.5, 14.0), 0.65
#: Layers that stand for ground whose speed grows evenly. Chosen by judgement: arrivals in more of
#: them differ by less than a sample.
STEPS = 10


@dataclass(frozen=True, slots=True)
class LineOptions:
    """What to simulate on a line. None leaves a choice open: it is drawn with ``random``.

    Attributes
    ----------
    seed
        Of everything that is random.
    shots
        How many, 1 to 50; None: 3.
    channels
        How many geophones, 4 to 96; None: 24.
    spacing_m
        Between geophones, 0.5 to 50 [m]; None: 5.
    rate_hz
        Sampling rate, 500 to 48000 [Hz]; None: 4000.
    length_s
        Of a record, 0.1 to 10 [s]; None: 0.5.
    lead_s
        Of a record before the trigger, 0 to 1 [s]; None: 0.
    source
        ``hammer``, or ``drop``, a falling weight: lower and stronger; None: hammer.
    stack
        How many blows are added up in a record, 1 to 50; None: 1.
    layers
        Thickness [m] and speed [m/s] of each layer, the last without end; None: 3 m of 400 m/s on
        1600 m/s. Speeds grow with depth.
    snr
        Swing of an arrival in the middle of those recorded, over the deviation of the noise; None:
        20.
    late_s
        By how much triggers come late, 0 to 0.05 [s]; None: 0.
    precursors
        Size of what comes up to 0.1 s before a shot from the same place, as a part of the shot, 0
        to 0.2; None: 0.
    rumble
        Deviation of the surface waves of traffic over that of the noise, 0 to 20; None: 0.
    dead, flipped
        Geophones without signal, and of the other polarity, by name.
    random
        Draw what is left open.
    """

    seed: int = 1
    shots: int | None = None
    channels: int | None = None
    spacing_m: float | None = None
    rate_hz: float | None = None
    length_s: float | None = None
    lead_s: float | None = None
    source: SourceName | None = None
    stack: int | None = None
    layers: tuple[tuple[float, float], ...] = ()
    snr: float | None = None
    late_s: float | None = None
    precursors: float | None = None
    rumble: float | None = None
    dead: tuple[str, ...] = ()
    flipped: tuple[str, ...] = ()
    random: bool = False


@dataclass(frozen=True, slots=True)
class _Settings:
    """:class:`LineOptions` of a single line, with nothing left open."""

    seed: int
    random: bool
    shots: int
    channels: int
    spacing_m: float
    rate_hz: float
    length_s: float
    lead_s: float
    source: str
    stack: int
    snr: float
    late_s: float
    precursors: float
    rumble: float


def refused(option: str, expected: str, actual: object) -> SimulationError:
    """Return the error that an option of the line is not what it must be."""
    return SimulationError(f"simulate line: {option}: expected {expected}, found {actual}")


#: Bounds of options, both allowed. Source: definition, see :class:`LineOptions`.
_BOUNDS = {
    "shots": (1, 50),
    "channels": (4, 96),
    "spacing_m": (0.5, 50),
    "rate_hz": (500, 48000),
    "length_s": (0.1, 10),
    "lead_s": (0, 1),
    "stack": (1, 50),
    "snr": (1, 1e6),
    "late_s": (0, 0.05),
    "precursors": (0, 0.2),
    "rumble": (0, 20),
}


def _check(options: LineOptions) -> None:
    for name, (low, high) in _BOUNDS.items():
        value = getattr(options, name)
        if value is not None and not low <= value <= high:
            raise refused(name, f"{low:g} to {high:g}", f"{value:g}")
    speeds = [v for _, v in options.layers]
    if any(h <= 0 or v <= 0 for h, v in options.layers) or sorted(set(speeds)) != speeds:
        raise refused("layers", "thickness and growing speed of each, above 0", options.layers)


@dataclass(frozen=True, slots=True)
class Ground:
    """Flat layers on a half-space.

    Attributes
    ----------
    thickness_m
        Of all layers but the last, shape (n - 1,).
    speed_mps
        Of P waves, growing, shape (n,).
    quality
        Q of P waves.
    surface_mps
        Of surface waves of high and of low frequency.
    surface
        Size of surface waves over that of the direct wave.
    air
        Size of sound in the air over that of the direct wave.
    """

    thickness_m: Array
    speed_mps: Array
    quality: float
    surface_mps: tuple[float, float]
    surface: float
    air: float

    def refracted(self, far_m: Array) -> Iterator[tuple[Array, Array]]:
        """Yield when each wave reaches offsets (n,) [s], and its size, the direct wave first.

        A refracted wave exists from the offset on at which its ray comes up again.
        """
        yield far_m / self.speed_mps[0], 1.0 / (1.0 + far_m) ** 1.3
        for k in range(1, len(self.speed_mps)):
            sine = self.speed_mps[:k] / self.speed_mps[k]
            cosine, deep = np.sqrt(1 - sine**2), self.thickness_m[:k]
            time_s = far_m / self.speed_mps[k] + float(
                np.sum(2 * deep * cosine / (sine * self.speed_mps[k]))
            )
            least_m = float(np.sum(2 * deep * sine / cosine))
            size = 0.5 / (1.0 + far_m) ** 1.5
            yield time_s, np.where(far_m >= least_m, size, 0.0)

    def reflected(self, far_m: Array) -> Iterator[tuple[Array, Array]]:
        """Yield when the reflection at the foot of each layer arrives [s], and its size."""
        vertical_s, squares = 0.0, 0.0
        for k, deep in enumerate(self.thickness_m):
            vertical_s += 2 * deep / self.speed_mps[k]
            squares += 2 * deep * self.speed_mps[k]
            contrast = self.speed_mps[k + 1] / self.speed_mps[k]
            size = 0.5 * (contrast - 1) / (contrast + 1) / (1.0 + far_m) ** 1.2
            yield np.sqrt(vertical_s**2 + far_m**2 * vertical_s / squares), size


@dataclass(frozen=True, slots=True)
class Line:
    """Everything that is drawn of a line, once for all of its shots.

    Attributes
    ----------
    settings
        With nothing left open.
    dead
        Names of geophones without signal.
    ground
        Under it.
    place_m, source_m
        Of geophones and shots along the line.
    static_s
        Delay of each geophone by the ground under it.
    gain
        Of each geophone, with its polarity; 0 of a dead one.
    natural_hz
        Of the geophones.
    centre_hz
        Of the source.
    hum_hz
        Of the mains.
    """

    settings: _Settings
    dead: tuple[str, ...]
    ground: Ground
    place_m: Array
    source_m: Array
    static_s: Array
    gain: Array
    natural_hz: float
    centre_hz: float
    hum_hz: float


def simulate_line(options: LineOptions | None = None) -> Simulation:
    """Simulate shots on a line of geophones.

    The truth: ``impact`` at each shot, ``pick`` at each arrival of a geophone that is not dead.
    ``trigger`` is what the recorder takes for the moment of the shot, which may be late. Records
    have gaps between them. The metadata record ``line`` holds what was drawn.

    Raises
    ------
    SimulationError
        Where an option is out of its range or names no geophone.
    """
    options = options or LineOptions()
    _check(options)
    line = _drawn(options, np.random.default_rng([options.seed, 0]))
    names = _names(len(line.place_m))
    channels = tuple(
        Channel(name, "voltage", "V", "z", VOLTS, (x, 0.0, 0.0))
        for name, x in zip(names, line.place_m.tolist(), strict=True)
    )
    stream = Stream("/seismic", channels, line.settings.rate_hz)
    shots = [_Shot(line, number) for number in range(len(line.source_m))]
    blocks = [SignalBlock(stream, START_NS, shot.first, shot.counts()) for shot in shots]
    labels = [label for shot in shots for label in shot.labels(names)]
    sensors = tuple(Sensor(n, n, x, 0.0) for n, x in zip(names, line.place_m.tolist(), strict=True))
    points = tuple((shot.name, float(line.source_m[shot.number]), 0.0) for shot in shots)
    return Simulation(
        sources=[(stream, "i32le", blocks)],
        geometry=Geometry(sensors=sensors, sources=points),
        labels=tuple(sorted(labels, key=lambda x: (x.time_ns, x.kind, x.channel))),
        metadata=described("line", options) | {"line": _description(line)},
    )


def _names(count: int) -> tuple[str, ...]:
    width = max(2, len(str(count)))
    return tuple(f"G{i:0{width}d}" for i in range(1, count + 1))


def _description(line: Line) -> dict[str, str]:
    """Return what was drawn, as text."""
    settings = {name: str(value) for name, value in asdict(line.settings).items()}
    layers = [f"{v:.0f} m/s" for v in line.ground.speed_mps.tolist()]
    deep = [f"{h:.1f} m" for h in line.ground.thickness_m.tolist()]
    settings["ground"] = ", ".join(
        f"{h} of {v}" for h, v in zip([*deep, "rest"], layers, strict=True)
    )
    return settings | {
        "quality": f"{line.ground.quality:.0f}",
        "centre_hz": f"{line.centre_hz:.0f}",
    }


# --- what is drawn ------------------------------------------------------------------------------


def _drawn(options: LineOptions, rng: Rng) -> Line:
    """Return a line with everything that options leave open drawn, or as usual."""
    settings = _opened(options, rng)
    n, apart_m, wild = settings.channels, settings.spacing_m, settings.random
    ground = _ground(options, rng, n * apart_m)
    place_m = np.round(np.arange(n) * apart_m, 3)
    names = _names(n)
    unknown = [name for name in (*options.dead, *options.flipped) if name not in names]
    if unknown:
        raise refused("dead, flipped", f"a geophone {names[0]} to {names[-1]}", unknown[0])
    sign = rng.random(n) < (0.03 if wild and not options.flipped else 0.0)
    silent = rng.random(n) < (0.03 if wild and not options.dead else 0.0)
    sign |= np.isin(names, options.flipped)
    silent |= np.isin(names, options.dead)
    gain = np.exp(rng.normal(0, 0.25, n)) * np.where(sign, -1.0, 1.0) * ~silent
    smooth = np.cumsum(rng.normal(0, 1, n)) / np.sqrt(n) * rng.uniform(0, 2e-3)
    static_s = np.abs(rng.normal(0, rng.uniform(0, 0.6e-3), n)) + smooth - smooth.min()
    return Line(
        settings,
        tuple(np.array(names)[silent].tolist()),
        ground,
        place_m,
        _sources(settings.shots, place_m, apart_m, rng),
        static_s if wild else np.zeros(n),
        gain,
        float(rng.uniform(*NATURAL_HZ)),
        float(rng.uniform(50, 120) if settings.source == "hammer" else rng.uniform(20, 60)),
        float(rng.choice([50.0, 60.0])),
    )


def _opened(options: LineOptions, rng: Rng) -> _Settings:
    """Return options with what is left open drawn, or as usual."""
    defaults: dict[str, Any] = {
        "shots": 3,
        "channels": 24,
        "spacing_m": 5.0,
        "rate_hz": 4000.0,
        "length_s": 0.5,
        "lead_s": 0.0,
        "source": "hammer",
        "stack": 1,
        "snr": 20.0,
        "late_s": 0.0,
        "precursors": 0.0,
        "rumble": 0.0,
    }
    drawn: dict[str, Any] = {
        "shots": int(rng.integers(3, 6)),
        "channels": int(rng.choice([12, 24, 24, 36, 48])),
        "spacing_m": float(rng.choice([1.0, 2.0, 3.0, 4.0, 5.0, 8.0, 10.0])),
        "rate_hz": float(rng.choice([1000, 2000, 4000, 8000, 16000])),
        "length_s": float(rng.choice([0.5, 1.0, 2.0])),
        "lead_s": float(rng.choice([0.0, 0.0, 0.01, 0.05, 0.1])),
        "source": str(rng.choice(["hammer", "hammer", "drop"])),
        "stack": int(rng.choice([1, 1, 3, 5, 10])),
        "snr": float(np.exp(rng.uniform(np.log(4), np.log(200)))),
        "late_s": float(rng.choice([0.0, 0.0, 0.0, rng.uniform(1e-3, 12e-3)])),
        "precursors": float(rng.choice([0.0, rng.uniform(0.002, 0.05)])),
        "rumble": float(rng.choice([0.0, rng.uniform(0.5, 4.0)])),
    }
    made = drawn if options.random else defaults
    given = {name: getattr(options, name) for name in made}
    chosen = {name: value for name, value in given.items() if value is not None}
    return _Settings(options.seed, options.random, **(made | chosen))


def _ground(options: LineOptions, rng: Rng, length_m: float) -> Ground:
    """Return the layers that are given, or those of a usual, or a drawn, site."""
    if options.layers:
        deep = np.array([h for h, _ in options.layers[:-1]])
        speed = np.array([v for _, v in options.layers])
    elif not options.random:
        deep, speed = np.array([3.0]), np.array([400.0, 1600.0])
    else:
        deep, speed = _layers(rng, length_m)
    slow = float(speed[0] * rng.uniform(0.35, 0.55))
    return Ground(
        deep,
        speed,
        float(rng.uniform(15, 80)),
        (slow, slow * float(rng.uniform(1.0, 1.6))),
        float(rng.uniform(1, 6)),
        float(rng.choice([0.0, rng.uniform(0.01, 0.1)])) if options.random else 0.0,
    )


def _layers(rng: Rng, length_m: float) -> tuple[Array, Array]:
    """Draw two to four layers, or speed that grows evenly with depth in the uppermost."""
    count = int(rng.integers(2, 5))
    speed = np.cumprod([rng.uniform(250, 800), *rng.uniform(1.4, 3.5, count - 1)])
    speed = np.minimum(speed, 6000 - 100.0 * np.arange(count)[::-1])
    deep = length_m * rng.uniform(0.02, 0.12, count - 1)
    if rng.random() < 0.35:
        parts = np.linspace(0, 1, STEPS, endpoint=False)
        speed = np.concatenate([speed[0] + (speed[1] - speed[0]) * parts, speed[1:]])
        deep = np.concatenate([np.full(STEPS, deep[0] / STEPS), deep[1:]])
    return deep, speed


def _sources(count: int, place_m: Array, apart_m: float, rng: Rng) -> Array:
    """Return shots beyond both ends and between geophones."""
    ends = place_m[0] - apart_m * rng.uniform(0.5, 6), place_m[-1] + apart_m * rng.uniform(0.5, 6)
    inside = place_m[0] + apart_m * (rng.integers(0, len(place_m) - 1, count) + 0.5)
    places = np.sort(np.concatenate([ends, inside])[rng.permutation(count + 2)][:count])
    return np.round(places, 2)


# --- one shot -----------------------------------------------------------------------------------


class _Shot:
    """One record of a line, made from its own random numbers."""

    def __init__(self, line: Line, number: int) -> None:
        self.line, self.number, self.name = line, number, str(number + 1)
        o = line.settings
        self.rate_hz, self.snr = o.rate_hz, o.snr
        self.first = round(number * APART_S * o.rate_hz)
        self.count = round(o.length_s * o.rate_hz)
        self.fold = max(1, int(np.ceil(FINE_HZ / o.rate_hz)))
        rng = np.random.default_rng([o.seed, 1, number])
        #: What the trigger is late by, and when the shot is after the first sample [s].
        self.late_s = float(o.late_s * (rng.random() < 0.7)) if o.random else o.late_s
        self.shot_s = round(o.lead_s * o.rate_hz) / o.rate_hz - self.late_s
        self.far_m = np.abs(line.place_m - line.source_m[number])
        self.centre_hz = line.centre_hz * float(rng.uniform(0.8, 1.25))
        self._rng = rng

    @cached_property
    def _frequency_hz(self) -> Array:
        fine = self.count * self.fold
        f = np.fft.rfftfreq(2 * fine, 1 / (self.rate_hz * self.fold))
        return np.asarray(f[f < HIGHEST_HZ])

    def _source(self, centre_hz: float) -> NDArray[np.complex128]:
        """Return the spectrum of what a blow does to a geophone: causal, with no delay."""
        s = 2j * np.pi * self._frequency_hz
        blow = 2 * np.pi * centre_hz
        natural_radps = 2 * np.pi * self.line.natural_hz
        pulse = blow**2 * s / (s + blow) ** 3
        geophone = s**2 / (s**2 + 2 * DAMPING * natural_radps * s + natural_radps**2)
        above = 2 * np.pi * 0.35 * self.rate_hz  # against aliases, as two poles of the recorder's
        jitter = np.exp(-0.5 * (s.imag * 1.5e-4) ** 2) if (self.line.settings.stack) > 1 else 1.0
        spectrum: NDArray[np.complex128] = pulse * geophone * (above / (s + above)) ** 2 * jitter
        return spectrum

    def _lossy(self, travel_s: Array, quality: float) -> NDArray[np.complex128]:
        """Return delay and loss of waves that travelled so long, shape (n, n_frequencies).

        The loss is causal: what is slower than the fastest frequency comes later.
        """
        f = self._frequency_hz
        slower = np.log(np.maximum(f, f[1]) / f[-1]) / (np.pi * quality)
        phase = 2 * np.pi * f * travel_s[:, None] * (1 - slower)
        return np.asarray(np.exp(-1j * phase - np.pi * f * travel_s[:, None] / quality))

    def _body(self, centre_hz: float) -> NDArray[np.complex128]:
        """Return the spectra of direct, refracted and reflected waves of a blow at time 0."""
        ground, far = self.line.ground, np.hypot(self.far_m, 0.3)
        total = np.zeros((len(far), len(self._frequency_hz)), np.complex128)
        for wave, waves in enumerate((ground.refracted(far), ground.reflected(far))):
            for time_s, size in waves:
                on = size > 0
                travel_s = (time_s + self.line.static_s)[on]
                total[on] += size[on, None] * (-1) ** wave * self._lossy(travel_s, ground.quality)
        return total * self._source(centre_hz)

    def _delay(self, at_s: float) -> NDArray[np.complex128]:
        return np.asarray(np.exp(-2j * np.pi * self._frequency_hz * at_s))

    def _slow(self, centre_hz: float) -> NDArray[np.complex128]:
        """Return the spectra of surface waves and sound in the air of a blow at time 0."""
        ground, far, f = self.line.ground, np.hypot(self.far_m, 0.3), self._frequency_hz
        fast, slow = ground.surface_mps[1], ground.surface_mps[0]
        speed = slow + (fast - slow) / (1 + (f / 25.0) ** 2)
        travel_s = far[:, None] / speed
        wave = np.exp(-2j * np.pi * f * travel_s - np.pi * f * travel_s / (0.5 * ground.quality))
        wave *= ground.surface / np.sqrt(1.0 + far[:, None]) / 4 * np.exp(-f / 60.0)
        sound = np.exp(-2j * np.pi * f * (far[:, None] / AIR_MPS)) / (1.0 + far[:, None])
        response = wave + ground.air * sound * (f > 80.0)
        return np.asarray(response * self._source(centre_hz))

    def _trace(self, spectra: NDArray[np.complex128], at_s: float) -> Array:
        """Return samples at the fine rate of a blow at a time, shape (n, n_fine)."""
        fine = 2 * self.count * self.fold
        samples = np.fft.irfft(spectra * self._delay(at_s), fine, axis=1)
        return np.asarray(samples[:, : fine // 2] * self.rate_hz * self.fold)

    @cached_property
    def _waves(self) -> NDArray[np.complex128]:
        return self._body(self.centre_hz)

    @cached_property
    def _alone(self) -> tuple[Array, Array]:
        """When each arrival begins after the shot [s], see :data:`BEGINS`, and its swing.

        Looked for behind the ray's arrival: periodic waves have no first sample.
        """
        waves = np.abs(self._trace(self._waves, _AHEAD_S))
        fine_hz = self.rate_hz * self.fold
        rays = [
            np.where(a > 0, t, np.inf)
            for t, a in self.line.ground.refracted(np.hypot(self.far_m, 0.3))
        ]
        first_s = np.min(rays, axis=0) + self.line.static_s
        begins, swing = np.full(len(first_s), np.nan), np.zeros(len(first_s))
        for c, ray_s in enumerate(first_s.tolist()):
            start = int((ray_s + _AHEAD_S) * fine_hz)
            part = waves[c, start : start + round(SWING_S * fine_hz)]
            if len(part):
                swing[c] = part.max()
                begins[c] = (start + int(np.argmax(part > BEGINS * swing[c]))) / fine_hz - _AHEAD_S
        return begins, swing

    @property
    def _scale(self) -> float:
        """Deviations of the noise in a unit of the waves."""
        begins, swing = self._alone
        recorded = swing[np.isfinite(begins) & (begins + self.shot_s < self.count / self.rate_hz)]
        return self.snr / float(np.median(recorded)) if len(recorded) else 1.0

    def samples(self) -> Array:
        """Return the record without gain and digitiser, shape (n_samples, n_channels).

        Its unit is such that the noise has a deviation of 1.
        """
        signal = self._trace(self._waves + self._slow(self.centre_hz), self.shot_s)
        for at_s, size in self._blows_before():
            before = self._body(0.7 * self.centre_hz) + self._slow(0.7 * self.centre_hz)
            signal += self._trace(before, at_s) * size
        return np.asarray(self._scale * signal[:, :: self.fold].T + self._noise())

    def _blows_before(self) -> list[tuple[float, float]]:
        """Return when weak blows come before the shot [s of the record], and their sizes."""
        size = self.line.settings.precursors
        if not size:
            return []
        count = int(self._rng.integers(1, 4))
        before_s = self._rng.uniform(0.015, 0.1, count)
        sizes = size * self._rng.uniform(0.2, 1.0, count)
        return list(zip((self.shot_s - before_s).tolist(), sizes.tolist(), strict=True))

    def _noise(self) -> Array:
        """Return what geophones record without a shot, shape (n_samples, n_channels)."""
        rng, n, channels = self._rng, self.count, len(self.far_m)
        t = np.arange(n)[:, None] / self.rate_hz
        noise = _coloured(rng, n, channels, self.rate_hz)
        noise *= np.exp(rng.normal(0, 0.3, channels))
        if rumble := self.line.settings.rumble:
            noise += rumble * self._traffic()
        if self.line.settings.random:
            noise += self._field(t)
        return np.asarray(noise)

    def _traffic(self) -> Array:
        """Return slow waves that cross the line from one side, of deviation 1."""
        rng, n = self._rng, self.count
        f = np.fft.rfftfreq(2 * n, 1 / self.rate_hz)
        low, high = rng.uniform(3, 10), rng.uniform(12, 30)
        shape = ((f > low) & (f < high)) * np.exp(2j * np.pi * rng.random(len(f)))
        slowness = rng.choice([-1, 1]) / rng.uniform(150, 600)
        delay = np.exp(-2j * np.pi * f * self.line.place_m[:, None] * slowness)
        waves = np.fft.irfft(shape * delay, axis=1)[:, :n].T
        return np.asarray(waves / max(float(waves.std()), 1e-12))

    def _field(self, t: Array) -> Array:
        """Return hum, gusts on single geophones, and cross-talk of the trigger."""
        rng, channels = self._rng, len(self.far_m)
        extra = np.zeros((len(t), channels))
        level = rng.uniform(0, 1.0, channels) * rng.choice([0.0, 1.0])
        for harmonic, part in ((1, 1.0), (3, 0.4)):
            phase = rng.uniform(0, 2 * np.pi, channels)
            extra += level * part * np.sin(2 * np.pi * harmonic * self.line.hum_hz * t + phase)
        for _ in range(int(rng.poisson(0.6))):
            c, at_s = int(rng.integers(channels)), rng.uniform(0, t[-1, 0])
            hz, size = rng.uniform(20, 150), rng.uniform(3, 12)
            since = np.maximum(t[:, 0] - at_s, 0)
            extra[:, c] += size * np.sin(2 * np.pi * hz * since) * np.exp(-since * hz / 3)
        if rng.random() < 0.3:
            coupled = rng.random(channels) < 0.15
            zero = self.shot_s + self.late_s
            since = np.maximum(t - zero, 0)
            pulse = (
                np.sin(2 * np.pi * 0.2 * self.rate_hz * since) * np.exp(-since / 2e-3) * (t >= zero)
            )
            extra += coupled * rng.uniform(3, 20, channels) * pulse
        return extra

    def counts(self) -> NDArray[np.int32]:
        """Return the record as stored: gains, digitiser, its limits."""
        step = 40.0  # counts of the noise's deviation
        gain = self.line.gain * step
        values = np.round(self.samples() * gain)
        return np.asarray(np.clip(values, -FULL, FULL), np.int32)

    def labels(self, names: tuple[str, ...]) -> Iterator[Label]:
        """Yield the truth of the shot, and its trigger."""
        start_ns = START_NS + round(self.first / self.rate_hz * NS_PER_S)
        x = float(self.line.source_m[self.number])

        def at(time_s: float) -> int:
            return start_ns + round(time_s * NS_PER_S)

        yield Label(at(self.shot_s), "impact", x_m=x, y_m=0.0, label=self.name, author=AUTHOR)
        trigger_ns = at(self.shot_s + self.late_s)
        yield Label(trigger_ns, "trigger", x_m=x, y_m=0.0, label=self.name, author=AUTHOR)
        last_s = (self.count - 1) / self.rate_hz
        begins, swing = self._alone
        least = SEEN * np.hypot(1.0, self.line.settings.rumble) / self._scale
        rows = zip(names, begins.tolist(), (swing >= least).tolist(), strict=True)
        for name, time_s, seen in rows:
            inside = 0.0 <= self.shot_s + time_s <= last_s
            if seen and inside and name not in self.line.dead:
                yield Label(at(self.shot_s + time_s), "pick", channel=name, author=AUTHOR)


def _coloured(rng: Rng, n: int, channels: int, rate_hz: float) -> Array:
    """Return noise of deviation 1 that is stronger at low frequencies, shape (n, channels)."""
    f = np.fft.rfftfreq(2 * n, 1 / rate_hz)
    corner = rng.uniform(5, 60)
    shape = 1 / (1 + (f / corner)) ** rng.uniform(0.3, 1.0) * (f > 2.0) / (1 + (f / 800.0) ** 2)
    phase = rng.standard_normal((channels, len(f))) + 1j * rng.standard_normal((channels, len(f)))
    waves = np.fft.irfft(shape * phase, axis=1)[:, :n].T
    return np.asarray(waves / waves.std(axis=0))
