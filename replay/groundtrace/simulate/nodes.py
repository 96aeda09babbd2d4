"""Nodes of three components in a row beside a road, drawn anew for each seed, and all they feel.

Nothing here follows the law of power that the stages of vehicles fit. A vehicle is what its axles
press on the ground: the roughness of the road (ISO 8608: density of height falls as the wave number
to the power 1.5 to 2.5), with joints and patches at some places, felt through the resonances of its
body and its wheels (D. Cebon, Handbook of vehicle-road interaction, 1999). The same force is felt
by all nodes, through a ground of drawn spreading, loss and dispersion. Beside vehicles walk people;
doors slam; gusts go over the site with the wind, and trucks drive on another road far away.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Protocol

import numpy as np

from groundtrace_codecs.geometry import Geometry, Medium, Sensor
from groundtrace_codecs.signals import Channel, SignalBlock, Stream

from .recording import START_NS
from .road import AXES, ROAD_M, Drive, Road
from .vehicle_signal import Burst, Frames, Vehicle

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from .road import VehicleOptions

    Array = NDArray[np.float64]
    Generator = np.random.Generator

#: Nodes; distance between two, by how much of it each is off; of the road from the row, and by
#: how much nodes are off the row [m]. Chosen by judgement.
_NODES, _SPACING_M, _UNEVEN, _OFFSET_M, _OFF_ROW_M = (3, 6), (5.0, 40.0), 0.25, (2.0, 15.0), 0.5
#: Waves [m/s], exponent of their dispersion, of the spreading of power, and quality of the
#: ground. Chosen by judgement.
_WAVES_MPS, _DISPERSION, _SPREADING, _QUALITY = (120.0, 500.0), (0.0, 0.3), (1.0, 2.4), (4.0, 60.0)
#: Standard deviation of the levels of nodes, and of their components [dB]. Chosen by judgement.
_NODE_DB, _COMPONENT_DB = 4.0, 2.0
#: Level of a mean car at the nodes over the noise [dB]; colour of that: exponent of its density.
#: Chosen by judgement.
_CAR_DB, _COLOUR = (12.0, 32.0), (0.0, 2.0)
#: Horizontal movement over vertical: of Rayleigh waves, and of shear waves across the ray. Chosen
#: by judgement.
_RADIAL, _TRANSVERSE = (0.3, 1.2), (0.2, 1.0)
#: Bands that are damped and delayed each for itself [Hz]. Chosen by judgement.
_EDGES_HZ = (3.0, 6.0, 10.0, 15.0, 22.0, 32.0, 45.0, 65.0)
#: Vehicles: name, share, level over a car's, axles behind its middle [m], resonances of body and
#: wheels [Hz], speed over the site's. Chosen by judgement.
_KINDS: tuple[tuple[str, float, float, tuple[float, ...], float, float, float], ...] = (
    ("scooter", 0.12, 0.35, (-0.65, 0.65), 2.5, 14.0, 0.8),
    ("car", 0.58, 1.0, (-1.35, 1.35), 1.4, 11.0, 1.0),
    ("van", 0.2, 1.6, (-1.65, 1.65), 1.6, 10.0, 0.95),
    ("truck", 0.1, 3.5, (-3.4, 1.0, 2.4), 2.2, 12.0, 0.8),
)
#: Speed of a site and its spread among vehicles, as a logarithm; by what part one changes on its
#: way; and the limits [m/s]. Chosen by judgement.
_SITE_MPS, _SPREAD, _CHANGE, _LIMITS_MPS = (6.0, 16.0), 0.2, 0.2, (3.0, 25.0)
#: Roughness: exponent of the density of height, length of a tyre's contact, distance of joints,
#: their length and their slope over the usual one [m]. Chosen by judgement.
_ROUGH, _CONTACT_M, _JOINTS_M, _JOINT_M, _JOINT = (1.5, 2.5), 0.15, (15.0, 80.0), 0.4, (1.0, 12.0)
#: Damping of body and wheels, and how much of the road wheels pass on. Chosen by judgement.
_DAMPING, _WHEEL = (0.3, 0.2), 1.0
#: A vehicle that stops does so for so long, and brakes and starts for so long [s]. Chosen by
#: judgement.
_STOP_S, _BRAKE_S = (4.0, 15.0), 3.0
#: A vehicle is computed while it is within so much of a node [m], at so many samples a second.
#: Chosen by judgement.
_REACH_M, _FORCE_HZ = 250.0, 1000.0
#: It comes and goes within this part of that time. Chosen by judgement.
_FADE = 0.25
#: Walkers: steps a second, speed, distance from the row; peak of a step at 3 m over the noise,
#: frequency and decay of its swing. Chosen by judgement.
_PACE_HZ, _WALK_MPS, _BESIDE_M = (1.6, 2.3), (1.0, 1.7), (1.0, 8.0)
_STEP_PEAK, _STEP_HZ, _STEP_S = (4.0, 20.0), (12.0, 40.0), (0.02, 0.06)
#: Doors: distance from the row, peak at 10 m over the noise, frequency, decay of the swing,
#: chance of a second blow and when it comes. Chosen by judgement.
_DOOR_M, _DOOR_PEAK, _DOOR_HZ, _DOOR_S = (4.0, 60.0), (8.0, 60.0), (8.0, 35.0), (0.04, 0.2)
_AGAIN, _AGAIN_S = 0.5, (0.1, 0.6)
#: Swells: half are gusts, of so long, so strong over the noise [dB], so low [Hz], that go over
#: the site with the wind. What is shorter is another at each node (A. G. Davenport, The spectrum
#: of horizontal gustiness, Q. J. R. Meteorol. Soc. 87, 1961: at 10 m/s and 20 m coherence ends at
#: 0.05 Hz): fluctuations of so many dB over so long. The other swells are trucks, so loud over
#: others, on a road so far away. Chosen by judgement.
_GUST_S, _GUST_DB, _GUST_HZ, _WIND_MPS = (6.0, 40.0), (4.0, 16.0), (6.0, 30.0), (3.0, 15.0)
_OWN_DB, _OWN_S = 3.0, (0.5, 3.0)
_FAR_M, _FAR_LEVEL = (60.0, 250.0), (0.5, 2.0)
#: Counts of a 32-bit digitiser in the least noise. Chosen by judgement.
_COUNTS = 64.0


def nodes_of(options: VehicleOptions) -> NodeSignal:
    """Draw a row of nodes, and all that they feel."""
    site = NodeSite.drawn(options, np.random.default_rng([options.seed, 31]))
    rides = rides_of(options, site, np.random.default_rng([options.seed, 32]))
    bursts = bursts_of(options, site, np.random.default_rng([options.seed, 33]))
    gusts, far = swells_of(options, site, np.random.default_rng([options.seed, 34]))
    return NodeSignal(options, site, rides, bursts, gusts, far)


def _between(rng: Generator, low_high: tuple[float, float]) -> float:
    return float(rng.uniform(*low_high))


def _log_between(rng: Generator, low_high: tuple[float, float]) -> float:
    return float(np.exp(rng.uniform(*np.log(low_high))))


@dataclass(frozen=True, slots=True, eq=False)
class NodeSite:
    """What was drawn of a site.

    Attributes
    ----------
    geometry
        Nodes near y = 0 in the order of x, and the road.
    road
        Its middle line.
    places
        Of the nodes, shape (n, 2) [m].
    gains
        Of each channel, shape (n_nodes, n_components).
    velocity_mps, dispersion, spreading, quality
        c at 15 Hz, c ~ f^-dispersion, power ~ r^-spreading and exp(-2 pi f r / (quality c)).
    radial, transverse
        Movement along and across the ray over the vertical one.
    noise, colour
        Root of the mean power of each channel's noise, a mean car at the nodes having 1; density ~
        f^-colour.
    speed_mps
        Middle speed of vehicles [m/s].
    rough
        Slope of the road each centimetre from :data:`_REACH_M` before the first node on.
    """

    geometry: Geometry
    road: Road
    places: Array
    gains: Array
    velocity_mps: float
    dispersion: float
    spreading: float
    quality: float
    radial: float
    transverse: float
    noise: Array
    colour: float
    speed_mps: float
    rough: Array

    @classmethod
    def drawn(cls, options: VehicleOptions, rng: Generator) -> NodeSite:
        """Draw a site; options that are given hold."""
        count = options.stations or int(rng.integers(*_NODES))
        spacing_m = options.spacing_m or _log_between(rng, _SPACING_M)
        steps = spacing_m * rng.uniform(1 - _UNEVEN, 1 + _UNEVEN, count - 1)
        along = np.append(0.0, np.cumsum(steps))
        places = np.stack([along, rng.normal(0, _OFF_ROW_M, count)], axis=1).round(2)
        drawn_m = _between(rng, _OFFSET_M) * rng.choice([-1.0, 1.0])
        offset_m = drawn_m if options.offset_m is None else options.offset_m
        components = options.components or 3
        axes = AXES if components == 3 else ("z",)
        names = [f"N{i + 1}" for i in range(count)]
        sensors = tuple(
            Sensor(name, name if components == 1 else f"{name}{axis}", x, y, axis=axis)
            for name, (x, y) in zip(names, places.tolist(), strict=True)
            for axis in axes
        )
        velocity_mps = _log_between(rng, _WAVES_MPS)
        corners = np.array([(-ROAD_M, offset_m), (along[-1] + ROAD_M, offset_m)])
        medium = Medium(velocity_mps=round(velocity_mps, 1))
        line = tuple((float(a), round(float(b), 2)) for a, b in corners)
        db = rng.normal(0, _NODE_DB, (count, 1)) + rng.normal(0, _COMPONENT_DB, (count, components))
        level_db = -_between(rng, _CAR_DB) + rng.normal(0, 2.0, (count, components))
        return cls(
            Geometry(sensors=sensors, medium=medium, road=line),
            Road.through(corners),
            places,
            10 ** (db / 20),
            velocity_mps,
            _between(rng, _DISPERSION),
            _between(rng, _SPREADING),
            _log_between(rng, _QUALITY),
            _between(rng, _RADIAL),
            _between(rng, _TRANSVERSE),
            10 ** (level_db / 20),
            _between(rng, _COLOUR),
            options.speed_mps or _log_between(rng, _SITE_MPS),
            _slope(rng, 2 * _REACH_M + 2 * ROAD_M + float(along[-1])),
        )

    @property
    def axes(self) -> tuple[str, ...]:
        """Of the components of each node."""
        return AXES if self.gains.shape[1] == len(AXES) else ("z",)

    @property
    def near_m(self) -> float:
        """How far the road is from the middle of the row [m]."""
        return max(1.0, abs(float(self.road.corners[0, 1] - self.places[:, 1].mean())))

    def amplitude(self, distance_m: Array, frequency_hz: float) -> Array:
        """Return what is left of an amplitude, that at the road's distance being 1."""
        r, at = np.maximum(distance_m, 0.7), self.near_m
        loss = np.pi * frequency_hz / (self.quality * self.wave_mps(frequency_hz))
        return np.asarray((r / at) ** (-self.spreading / 2) * np.exp(-loss * (r - at)))

    def wave_mps(self, frequency_hz: float) -> float:
        """Return the speed of waves [m/s]."""
        return float(self.velocity_mps * (frequency_hz / 15.0) ** -self.dispersion)

    def components_of(self, waves: NDArray[np.complex128], away: Array) -> Array:
        """Return what the channels of all nodes feel.

        Parameters
        ----------
        waves
            Vertical movement, analytic, shape (n, n_nodes).
        away
            From the source to the nodes, shape (n, n_nodes, 2) [m].

        Returns
        -------
        Shape (n, n_nodes, n_components).
        """
        if len(self.axes) == 1:
            return np.asarray(waves.real[..., None])
        unit = away / np.maximum(np.linalg.norm(away, axis=-1, keepdims=True), 0.1)
        along, across = self.radial * waves.imag, self.transverse * waves.real
        x = along * unit[..., 0] - across * unit[..., 1]
        y = along * unit[..., 1] + across * unit[..., 0]
        return np.stack([x, y, waves.real], axis=-1)

    def metadata(self) -> dict[str, str]:
        """Return what was drawn, for the metadata."""
        names = ("velocity_mps", "dispersion", "spreading", "quality", "colour", "speed_mps")
        return {name: f"{getattr(self, name):.4g}" for name in names}


def _slope(rng: Generator, length_m: float) -> Array:
    """Return the slope of a rough road each centimetre, of variance 1 but for joints."""
    n = round(length_m * 100)
    wave = np.maximum(np.fft.rfftfreq(n, 0.01), 1 / length_m)
    drawn = rng.standard_normal(len(wave)) + 1j * rng.standard_normal(len(wave))
    shape = wave ** (1 - _between(rng, _ROUGH) / 2) / (1 + (wave * _CONTACT_M) ** 2)
    slope = np.fft.irfft(drawn * np.where(wave > 0.02, shape, 0.0), n)
    slope /= slope.std()
    every_m, strong = _log_between(rng, _JOINTS_M), _log_between(rng, _JOINT)
    size = round(_JOINT_M * 100)
    up_and_down = np.sin(2 * np.pi * np.arange(size) / size)
    for _ in range(rng.poisson(length_m / every_m)):
        at = int(rng.integers(0, n - size))
        slope[at : at + size] += strong * rng.uniform(0.5, 1.5) * up_and_down
    return np.asarray(slope)


class Source(Protocol):
    """What is felt for some time."""

    def span_s(self, site: NodeSite) -> tuple[float, float]:
        """Return from when to when it is felt [s]."""
        ...

    def response(self, site: NodeSite, time_s: Array) -> Array:
        """Return what channels feel, shape (n, n_nodes, n_components)."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Ride:
    """A vehicle on its way.

    Attributes
    ----------
    vehicle
        Its name, its way, and its level (mu is unused).
    kind, level, axles_m, body_hz, wheel_hz
        As in :data:`_KINDS`.
    rough
        The road's slope under it, each centimetre from ``rough_m`` along its way on.
    rough_m
        Where that begins [m].
    """

    vehicle: Vehicle
    kind: str
    level: float
    axles_m: tuple[float, ...]
    body_hz: float
    wheel_hz: float
    rough: Array
    rough_m: float

    def span_s(self, site: NodeSite) -> tuple[float, float]:
        """Return from when to when it is near any node [s]."""
        drive = self.vehicle.drive
        time_s = np.arange(drive.pass_s - 180.0, drive.pass_s + 180.0, 0.5)
        near_m = np.min([drive.distances(time_s, p) for p in site.places], axis=0)
        near = time_s[near_m <= max(_REACH_M, 1.5 * float(near_m.min()))]
        return (float(near[0]), float(near[-1])) if len(near) else (0.0, 0.0)

    def response(self, site: NodeSite, time_s: Array) -> Array:
        """Return what channels feel: axle by axle, band by band."""
        from scipy.signal import butter, hilbert, sosfiltfilt

        grid_s = np.arange(time_s[0] - 4.0, time_s[-1] + 0.5, 1 / _FORCE_HZ)
        edges = [e for e in _EDGES_HZ if e < 0.45 / (time_s[1] - time_s[0])]
        out = np.zeros((len(time_s), *site.gains.shape))
        for axle_m in self.axles_m:
            force = self._force(grid_s, axle_m)
            for low, high in pairwise(edges):
                sos = butter(2, (low, high), "bandpass", fs=_FORCE_HZ, output="sos")
                part = hilbert(sosfiltfilt(sos, force))
                out += self._radiated(site, time_s, grid_s, part, axle_m, (low * high) ** 0.5)
        start_s, stop_s = self.span_s(site)  # far away it comes and goes slowly
        near = np.minimum(time_s - start_s, stop_s - time_s) / (_FADE * (stop_s - start_s))
        return np.asarray(self.level * out * np.clip(near, 0, 1)[:, None, None])

    def _force(self, grid_s: Array, axle_m: float) -> Array:
        """Return an axle's force on the ground: the road's slope through body and wheels."""
        from scipy.signal import lfilter

        drive = self.vehicle.drive
        way = self._along(grid_s, axle_m)
        at = np.clip((way - self.rough_m) * 100, 0, len(self.rough) - 1)
        climbed = np.interp(at, np.arange(len(self.rough)), self.rough) * drive.speeds(grid_s)
        total = np.zeros(len(grid_s))
        hz_gain = ((self.body_hz, 1.0), (self.wheel_hz, _WHEEL))
        for (hz, gain), damping in zip(hz_gain, _DAMPING, strict=True):
            w = 2 * np.pi * hz / _FORCE_HZ
            pole = np.exp(-damping * w)
            turn = 2 * pole * np.cos(w * np.sqrt(1 - damping**2))
            total += gain * lfilter([w, -w], [1.0, -turn, pole**2], climbed)
        return total

    def _along(self, time_s: Array, axle_m: float) -> Array:
        drive = self.vehicle.drive
        sign = 1.0 if drive.forward else -1.0
        return drive.along_m + sign * (drive.travelled(time_s) - axle_m)

    def _radiated(
        self,
        site: NodeSite,
        time_s: Array,
        grid_s: Array,
        part: NDArray[np.complex128],
        axle_m: float,
        frequency_hz: float,
    ) -> Array:
        speed = site.wave_mps(frequency_hz)
        emitted = np.repeat(time_s[:, None], len(site.places), axis=1)
        for _ in range(3):  # the way changes little while waves are under way
            places = self.vehicle.drive.road.places(self._along(emitted, axle_m))
            away = site.places - places
            distance = np.hypot(away[..., 0], away[..., 1])
            emitted = time_s[:, None] - distance / speed
        waves = np.interp(emitted, grid_s, part)
        return site.components_of(site.amplitude(distance, frequency_hz) * waves, away)


def rides_of(options: VehicleOptions, site: NodeSite, rng: Generator) -> list[Ride]:
    """Draw the vehicles in order of passing the middle of the row, each on its lane."""
    length_s, count = options.length_s, options.passes
    edge_s = min(10.0, length_s / 4)
    times = np.sort(rng.uniform(edge_s, length_s - edge_s, count))
    ahead = rng.random(count) < 0.5
    if options.overlap:
        times[1] = times[0] + rng.uniform(0.5, 2.0)
        ahead[:2] = True, False
    stops = set(rng.choice(count, min(options.stops or 0, count), replace=False).tolist())
    rides: list[Ride] = []
    car_level = _car_level(site)
    for number in np.argsort(times, kind="stable").tolist():
        kind = _KINDS[int(rng.choice(len(_KINDS), p=[k[1] for k in _KINDS]))]
        speed = float(np.clip(site.speed_mps * kind[6] * np.exp(_SPREAD * rng.standard_normal()),
                              *_LIMITS_MPS))  # fmt: skip
        knots = _knots(rng, float(times[number]), speed, stopping=number in stops)
        lane = site.road.beside(-1.5 if ahead[number] else 1.5)
        ride = _ride(site, kind, lane, float(times[number]), knots, bool(ahead[number]), site.rough)
        level = ride.level / car_level * 10 ** (rng.normal(0, 3.0) / 20)
        named = replace(ride.vehicle, name=f"V{len(rides) + 1}")
        rides.append(replace(ride, level=level, vehicle=named))
    return rides


def _knots(
    rng: Generator, time_s: float, speed: float, *, stopping: bool
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Draw how a speed changes; who stops does so within some seconds of the middle."""
    end = float(np.clip(speed * (1 + rng.uniform(-_CHANGE, _CHANGE)), *_LIMITS_MPS))
    if not stopping:
        return (time_s - 10.0, time_s + 10.0), (speed, end)
    begin = time_s + rng.uniform(-3.0, 3.0)
    stays = _between(rng, _STOP_S)
    brake = _BRAKE_S * max(1.0, speed / 8.0)
    return (
        (begin, begin + brake, begin + brake + stays, begin + 2 * brake + stays),
        (speed, 0.0, 0.0, end),
    )


def _ride(
    site: NodeSite,
    kind: tuple[str, float, float, tuple[float, ...], float, float, float],
    lane: Road,
    time_s: float,
    knots: tuple[tuple[float, ...], tuple[float, ...]],
    ahead: bool,
    rough: Array,
) -> Ride:
    along = lane.nearest_m(site.places.mean(axis=0))
    drive = Drive(lane, time_s, along, *knots, ahead)
    name, _, level, axles, body, wheel, _ = kind
    vehicle = Vehicle("", drive, 0.0, ())
    return Ride(vehicle, name, level, axles, body, wheel, rough, -_REACH_M)


def _car_level(site: NodeSite) -> float:
    """Return the root of the greatest power, over a second, that nodes feel of a car at 10 m/s."""
    car = next(kind for kind in _KINDS if kind[0] == "car")
    time_s = np.arange(-4.0, 4.0, 1 / 200)
    powers = []
    for position in site.places:
        lane = site.road
        drive = Drive(lane, 0.0, lane.nearest_m(position), (0.0,), (10.0,), True)
        vehicle = Vehicle("", drive, 0.0, ())
        ride = Ride(vehicle, car[0], 1.0, car[3], car[4], car[5], site.rough, -_REACH_M)
        power = (ride.response(site, time_s) ** 2).mean(axis=(1, 2))
        powers.append(float(np.convolve(power, np.ones(200) / 200, "valid").max()))
    return float(np.sqrt(np.median(powers)))


@dataclass(frozen=True, slots=True, eq=False)
class Blow:
    """A burst, as nodes feel it."""

    burst: Burst

    def span_s(self, site: NodeSite) -> tuple[float, float]:
        """Return from when to when it is felt [s]."""
        b = self.burst
        far_m = float(np.hypot(*(site.places - (b.x_m, b.y_m)).T).max())
        return b.time_s, b.time_s + far_m / site.wave_mps(b.frequency_hz) + 8 * b.decay_s

    def response(self, site: NodeSite, time_s: Array) -> Array:
        """Return what channels feel: a swing that rises within a quarter of a period and decays."""
        b = self.burst
        away = site.places - (b.x_m, b.y_m)
        distance = np.hypot(*away.T)
        late = time_s[:, None] - b.time_s - distance / site.wave_mps(b.frequency_hz)
        after = np.maximum(late, 0.0)
        rise = 1 - np.exp(-after * 4 * b.frequency_hz)
        swing = rise * np.exp((2j * np.pi * b.frequency_hz - 1 / b.decay_s) * after)
        peak = b.peak_mps * site.amplitude(distance, b.frequency_hz)
        waves = np.zeros(late.shape, np.complex128)
        waves += np.where(late > 0, peak, 0.0) * swing
        return site.components_of(waves, np.broadcast_to(away, (len(time_s), *away.shape)))


def bursts_of(options: VehicleOptions, site: NodeSite, rng: Generator) -> list[Burst]:
    """Draw steps of people who walk along the row, and doors, in order of time."""
    bursts = [b for n in range(options.walkers) for b in _walk(options, site, f"W{n + 1}", rng)]
    for _ in range(options.impacts):
        bursts += _door(options, site, rng)
    return sorted(bursts, key=lambda b: (b.time_s, b.target))


def _peak(site: NodeSite, over_noise: float, at_m: float, frequency_hz: float) -> float:
    """Return the peak at the road's distance of what is so much over the noise at another."""
    noise = float(np.median(site.noise))
    return over_noise * noise / float(site.amplitude(np.array(at_m), frequency_hz))


def _walk(options: VehicleOptions, site: NodeSite, name: str, rng: Generator) -> list[Burst]:
    pace, speed = _between(rng, _PACE_HZ), _between(rng, _WALK_MPS)
    ends = np.array([site.places[0, 0] - 15.0, site.places[-1, 0] + 15.0])
    lasts_s = float(np.ptp(ends)) / speed
    start = rng.uniform(min(0.0, options.length_s - lasts_s), max(0.0, options.length_s - lasts_s))
    beside = _between(rng, _BESIDE_M) * rng.choice([-1.0, 1.0])
    backward = rng.random() < 0.5
    hz, decay, over = _between(rng, _STEP_HZ), _between(rng, _STEP_S), _between(rng, _STEP_PEAK)
    peak = _peak(site, over, 3.0, hz)
    bursts = []
    for k, late in enumerate(np.arange(0.0, lasts_s, 1 / pace)):
        time_s = float(start + late + rng.normal(0, 0.02))
        if not 0 <= time_s < options.length_s:
            continue
        x = float(ends[1] - speed * late if backward else ends[0] + speed * late)
        step_peak = peak * (1.1 if k % 2 else 0.9) * float(np.exp(0.2 * rng.standard_normal()))
        y = beside + 0.1 * (-1) ** k
        bursts.append(Burst(time_s, x, y, step_peak, hz, decay, name))
    return bursts


def _door(options: VehicleOptions, site: NodeSite, rng: Generator) -> list[Burst]:
    time_s = float(rng.uniform(0, options.length_s - 1.0))
    x = float(rng.uniform(site.places[0, 0] - 30.0, site.places[-1, 0] + 30.0))
    y = _log_between(rng, _DOOR_M) * float(rng.choice([-1.0, 1.0]))
    hz, decay = _between(rng, _DOOR_HZ), _between(rng, _DOOR_S)
    peak = _peak(site, _log_between(rng, _DOOR_PEAK), 10.0, hz)
    bursts = [Burst(time_s, x, y, peak, hz, decay)]
    if rng.random() < _AGAIN:
        again = time_s + _between(rng, _AGAIN_S)
        bursts.append(Burst(again, x, y, peak * float(rng.uniform(0.2, 1.0)), hz, decay))
    return bursts


@dataclass(frozen=True, slots=True, eq=False)
class Gust:
    """Wind that shakes what stands at each node, one after the other as it goes over them.

    Attributes
    ----------
    time_s, lasts_s
        When it is at the middle of the row, and how long anywhere [s].
    level
        Root of the power over that of the noise.
    along_mps
        Speed along the row, below 0 backward [m/s].
    high_hz
        It shakes below this.
    own_s
        Over which each node has fluctuations of its own.
    seed
        Of its noise.
    """

    time_s: float
    lasts_s: float
    level: float
    along_mps: float
    high_hz: float
    own_s: float
    seed: tuple[int, ...]

    def _middles(self, site: NodeSite) -> Array:
        x = site.places[:, 0]
        return np.asarray(self.time_s + (x - x.mean()) / self.along_mps)

    def span_s(self, site: NodeSite) -> tuple[float, float]:
        """Return from when to when it is felt [s]."""
        middles = self._middles(site)
        return float(middles.min() - self.lasts_s), float(middles.max() + self.lasts_s)

    def response(self, site: NodeSite, time_s: Array) -> Array:
        """Return what channels feel: noise of their own, under an envelope that comes along."""
        from scipy.signal import butter, oaconvolve, sosfilt

        rng = np.random.default_rng(self.seed)
        drawn = rng.standard_normal((len(time_s), *site.gains.shape))
        rate = (len(time_s) - 1) / (time_s[-1] - time_s[0])
        high = min(self.high_hz, 0.45 * rate)
        shaken = sosfilt(butter(2, (2.0, high), "bandpass", fs=rate, output="sos"), drawn, axis=0)
        shaken /= shaken.std()
        part = (time_s[:, None] - self._middles(site)) / self.lasts_s
        envelope = np.where(np.abs(part) < 1, np.cos(np.pi * part / 2) ** 2, 0.0)
        window = np.hanning(max(3, 2 * round(self.own_s * rate)) + 2)[1:-1, None]
        fluctuation = oaconvolve(rng.standard_normal(part.shape), window, "same", axes=0)
        envelope *= 10 ** (_OWN_DB / 20 * fluctuation / np.sqrt((window**2).sum()))
        return np.asarray(self.level * site.noise * envelope[..., None] * shaken)


def swells_of(
    options: VehicleOptions, site: NodeSite, rng: Generator
) -> tuple[list[Gust], list[Ride]]:
    """Draw gusts, and trucks on a road far away."""
    gusts: list[Gust] = []
    far: list[Ride] = []
    truck = _KINDS[-1]
    car_level = _car_level(site)
    for number in range(options.swells or 0):
        time_s = float(rng.uniform(0, options.length_s))
        if rng.random() < 0.5:
            along = _between(rng, _WIND_MPS) / float(np.cos(rng.uniform(0, 1.3)))
            level = 10 ** (_between(rng, _GUST_DB) / 20)
            gusts.append(
                Gust(
                    time_s,
                    _log_between(rng, _GUST_S),
                    level,
                    along * float(rng.choice([-1.0, 1.0])),
                    _between(rng, _GUST_HZ),
                    _log_between(rng, _OWN_S),
                    (options.seed, 35, number),
                )
            )
            continue
        away = _log_between(rng, _FAR_M)
        angle = rng.uniform(0, 2 * np.pi)
        position = site.places.mean(axis=0) + away * np.array([-np.sin(angle), np.cos(angle)])
        speed = _between(rng, (8.0, 22.0))
        rough = _slope(rng, 1200.0)
        ride = _ride(
            site,
            truck,
            Road.straight(position, angle),
            time_s,
            ((0.0,), (speed,)),
            bool(rng.random() < 0.5),
            rough,
        )
        far.append(
            replace(
                ride, rough_m=-600.0, level=ride.level / car_level * _log_between(rng, _FAR_LEVEL)
            )
        )
    return gusts, far


@dataclass(frozen=True, eq=False)
class NodeSignal:
    """The samples of a row of nodes, a second at a time; iterating again gives the same."""

    options: VehicleOptions
    site: NodeSite
    rides: Sequence[Ride]
    bursts: Sequence[Burst]
    gusts: Sequence[Gust]
    far: Sequence[Ride]

    @cached_property
    def stream(self) -> Stream:
        """Its channels, whose scales are counts of a digitiser."""
        scale = float(self.site.noise.min()) / _COUNTS * 1e-6
        channels = tuple(
            Channel(s.channel, "ground_velocity", "m/s", s.axis, scale, (s.x, s.y, s.z))
            for s in self.site.geometry.sensors
        )
        return Stream("/seismic", channels, self.options.rate_hz)

    def __iter__(self) -> Iterator[SignalBlock]:
        rate = self.options.rate_hz
        total, size = round(self.options.length_s * rate), round(rate)
        waiting = self._sources(rate)
        active: list[tuple[int, Array]] = []
        noise = self._noise()
        shape = (size, *self.site.gains.shape)
        for first in range(0, total, size):
            moved = noise.samples(first, size).real.reshape(shape).copy()
            while waiting and waiting[-1][0] < first + size:
                start, stop, source = waiting.pop()
                time_s = np.arange(start, stop) / rate
                active.append((start, source.response(self.site, time_s) * self.site.gains))
            active = [(start, x) for start, x in active if start + len(x) > first]
            for start, x in active:
                a, b = max(first, start), min(first + size, start + len(x))
                moved[a - first : b - first] += x[a - start : b - start]
            counts = np.rint(1e-6 * moved.reshape(size, -1)[: total - first] / self.stream.scales)
            yield SignalBlock(self.stream, START_NS, first, counts.astype(np.int32))

    def _sources(self, rate: float) -> list[tuple[int, int, Source]]:
        """Return first and last sample of every source, the next one last."""
        spans: list[tuple[int, int, Source]] = []
        sources: list[Source] = [
            *self.rides,
            *self.far,
            *(Blow(b) for b in self.bursts),
            *self.gusts,
        ]
        for source in sources:
            start_s, stop_s = source.span_s(self.site)
            start, stop = (
                int(np.floor(max(start_s, 0.0) * rate)),
                int(np.ceil(min(stop_s, self.options.length_s) * rate)),
            )
            if stop - start > 1:
                spans.append((start, stop, source))
        return sorted(spans, key=lambda row: -row[0])

    def _noise(self) -> Frames:
        """Return noise of the site's colour, one column a channel."""
        rate, levels = self.options.rate_hz, (self.site.noise * self.site.gains).ravel()
        count = 2 * round(rate)
        f = np.arange(count // 2) * rate / count
        density = np.where(f >= 1.0, np.maximum(f, 1.0) ** -self.site.colour, 0.0)
        inside = (f >= 5.0) & (f <= 60.0)
        line = np.sqrt(density / density[inside].sum())

        def draw(number: int) -> NDArray[np.complex128]:
            rng = np.random.default_rng([self.options.seed, 36, number + 1])
            drawn = rng.standard_normal((2, len(f), len(levels)))
            spectrum = line[:, None] * levels * (drawn[0] + 1j * drawn[1])
            frame: NDArray[np.complex128] = np.fft.ifft(spectrum, count, axis=0) * count
            return frame

        return Frames(round(rate), draw)
