"""People walking on a concrete floor under seismic sensors.

The floor is the plate of :mod:`.localizers.wave_physics`, a step the force of :mod:`.footfall`:
waves are dispersive. Without options one person walks a U through a room of 5.4 m x 5.4 m, the size
of the thesis's test room (section 6.2), to and fro, at 0.5 to 0.6 s a step, and the floor has no
end.

The wave that a straight wall sends back is that of a second force behind the wall, as far from it
as the true one (method of images), its amplitude multiplied by the reflection. A sensor sees that
image where the ray from the image crosses its wall, and no other wall stands in the ray's way. A
rectangle also has the images of images: eight, one behind each corner and two more behind each pair
of walls, which every place inside sees. Any other outline has the first reflections only.

The slab goes on under the walls: where an outline is not convex and a wall hides the foot from the
sensor, the direct wave comes straight through with sqrt(1 - reflection^2) for each wall it crosses,
so that the law of arrivals holds there too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.events import Label
from groundtrace_codecs.geometry import Medium
from groundtrace_codecs.signals import NS_PER_S, Channel, SignalBlock, Stream

from ..localizers.wave_physics import Plate, Synthesis
from .footfall import SHOES, ArrivalLaw, Shoe
from .recording import AUTHOR, START_NS, Simulation, described
from .room_plan import (
    LATEST_S,
    Mounting,
    RoomOptions,
    any_law,
    course_of,
    drawn,
    refused,
    site_of,
    stations_of,
)
from .wave_laws import UNEVEN_M, Ground, UnevenFloor, ground_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.geometry import Geometry

    from ..localizers.wave_physics import WaveMedium
    from .room_plan import Strike

    Array = NDArray[np.float64]
    Spectra = NDArray[np.complex128]

#: Chosen by judgement: a trade of the two.
_NOISE_COUNTS = 4.0  # of the digitiser: real noise, yet half of every sample compresses away
#: A step beside a sensor reaches 1.8 times the peak at 1 m, a wall or a mounting adds to it: the
#: digitiser's range is this many times the peak. Chosen by judgement: no step clips.
_HEADROOM, _RESONANT = 2.5, 3.0
#: Chosen by judgement: most steps clip.
_CLIPPED_AT = 0.5  # of the median strike's peak: where a channel with too much gain clips


def simulate_room(options: RoomOptions | None = None) -> Simulation:
    """Simulate a walk through the room, two walks that cross, or single impacts.

    The truth: ``step`` with place and foot at each heel's contact, or ``impact`` with its place;
    ``pick`` per strike and channel at the arrival by :class:`.footfall.ArrivalLaw`, as late as the
    channel's clock, none where the channel is dead; and one ``walking`` span per walker. Where two
    walk, ``target`` of each label says who. The metadata record ``clock_offset_s`` holds clocks
    that are off.

    Raises
    ------
    SimulationError
        Where an option is out of its range, people cannot walk within the outline, or the steps do
        not fit in the duration.
    """
    options = options or RoomOptions()
    options.check()
    if options.wave_law == "any":
        options = any_law(options)
    if options.random:
        options = drawn(options)
    site = site_of(options)
    floor, faults = Floor.of(options, site), Faults.of(options, site)
    course = course_of(options, site.outline, floor.shoes)
    site = replace(site, start=course.start, medium=floor.medium)
    field = _field(options, site, floor, faults)
    peak_mps = floor.laws[0].peak_mps
    sigma_mps = peak_mps / options.snr
    scale = max(sigma_mps / _NOISE_COUNTS, _headroom(options) * peak_mps / 32767)
    scales = np.full(len(site.sensors), scale)
    if faults.clipped.any():
        scales[faults.clipped] = _clipping(field, course.strikes)[faults.clipped]
    rails = np.full(len(scales), 32767.0)
    if options.clip_at is not None:
        rails = np.minimum(rails, np.rint(options.clip_at * peak_mps / scales))
    channels = tuple(
        Channel(s.channel, "ground_velocity", "m/s", s.axis, float(per_count), (s.x, s.y, s.z))
        for s, per_count in zip(site.sensors, scales, strict=True)
    )
    stream = Stream("/seismic", channels, options.rate_hz)
    signal = RoomSignal(
        stream,
        options.seed,
        course.duration_s,
        course.strikes,
        field,
        sigma_mps,
        faults.dead,
        rails,
    )
    reported = replace(options, geometry=None, channels=len(field.channels.stations))
    return Simulation(
        sources=[(stream, "i16le", signal)],
        geometry=site,
        labels=labels_of(course.strikes, site, floor, faults),
        metadata=described("room", reported) | faults.described(site),
    )


def _field(options: RoomOptions, site: Geometry, floor: Floor, faults: Faults) -> Wavefield:
    stations, station = stations_of(site)
    axes = tuple(s.axis for s in site.sensors)
    channels = Channels(stations, station, axes, faults.offset_s, _gains(options, station))
    corners = np.array(list(dict.fromkeys(site.outline)), np.float64)
    walls = Walls(corners, options.walls or 0.0)
    farthest = 1 if not walls.reflection else 3 if walls.rectangular else 2
    spread_s = float(np.ptp(faults.offset_s))
    reach_m = farthest * extent_m(site) * floor.paths.most
    synthesis = synthesis_of(floor.plate, options.rate_hz, reach_m, spread_s)
    mounting = None
    if options.resonances:
        mounting = Mounting.drawn(len(stations), options.seed).response(synthesis.frequency_hz)
    return Wavefield(synthesis, channels, walls, floor.paths, mounting)


def _gains(options: RoomOptions, station: NDArray[np.intp]) -> Array:
    """Return the gain of each channel, that of its station, shape (n_channels,)."""
    rng = np.random.default_rng([options.seed, 12])
    gain: Array = np.exp(rng.normal(0.0, options.gain_spread or 0.0, station.max() + 1))[station]
    return gain


def _headroom(options: RoomOptions) -> float:
    """Return full scale over the peak of a mean step at 1 m: no channel clips by itself."""
    corner = (1 + (options.walls or 0.0)) ** 2  # of two walls
    return _HEADROOM * corner * (_RESONANT if options.resonances else 1.0)


def _clipping(field: Wavefield, strikes: Sequence[Strike]) -> NDArray[np.float64]:
    """Return for each channel the scale with which most strikes clip, shape (n_channels,)."""
    strikes = [strike for strike in strikes if not strike.disturbs]
    some = strikes[:: max(len(strikes) // 20, 1)]
    peaks = [np.abs(field.waves(strike)).max(axis=0) for strike in some]
    scale: NDArray[np.float64] = _CLIPPED_AT * np.median(peaks, axis=0) / 32767
    return scale


#: Chosen by judgement: mains, and a machine.
_HUM = ((50.0, 0.25), (11.0, 0.5))  # frequency [Hz] and amplitude over the noise's deviation
#: Horizontal over vertical movement at 200 Hz, in the middle of a footstep's band; a Rayleigh wave
#: has about as much at any frequency. In a plate it grows with the wave number. Chosen by
#: judgement.
_RADIAL, _RADIAL_HZ = 0.6, 200.0
#: Chosen by judgement: the ringing fades with the distance from the onset.
_LEAD = 16  # samples: a waveform is band-limited and rings before its onset


#: Rounding that is no distance [m]. Chosen by judgement: a nanometre.
_EPSILON = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Images:
    """Where waves seem to come from: the force first, then its images.

    Attributes
    ----------
    places
        Shape (n, 2) [m].
    gains
        Factor of the wave from each at each place asked for, shape (n, n_places); 0 where unseen.
    """

    places: Array
    gains: Array


@dataclass(frozen=True, slots=True, eq=False)
class Walls:
    """The outline as a mirror.

    Attributes
    ----------
    corners
        In order round the room, clockwise or not, shape (k, 2) [m].
    reflection
        Of the amplitude, 0 to 1.
    """

    corners: Array
    reflection: float

    @property
    def _ends(self) -> Array:
        return np.roll(self.corners, -1, axis=0)

    @property
    def _inward(self) -> Array:
        """Unit vectors into the room, square to each wall, shape (k, 2)."""
        x, y = self.corners.T
        along = self._ends - self.corners
        along /= np.hypot(*along.T)[:, None]
        turn = np.sign(x @ np.roll(y, -1) - y @ np.roll(x, -1))
        inward: Array = turn * np.stack([-along[:, 1], along[:, 0]], axis=1)
        return inward

    @property
    def rectangular(self) -> bool:
        """Whether the outline is a rectangle."""
        along = self._ends - self.corners
        products = np.einsum("ij,ij->i", along, np.roll(along, -1, axis=0))
        return len(self.corners) == 4 and bool(np.abs(products).max() < 1e-6)

    def images(self, source: Array, places: Array) -> Images:
        """Return the force at ``source``, shape (2,), and its images, as seen from ``places``."""
        if self.reflection == 0:
            return Images(source[None], np.ones((1, len(places))))
        through = np.sqrt(1 - self.reflection**2) ** self._crossed(source, places, None)
        mirrored = [self._mirrored(source, wall) for wall in range(len(self.corners))]
        seen = [
            self.reflection * self._seen(source, places, wall) for wall in range(len(self.corners))
        ]
        if self.rectangular:
            inside = self._inside(places)
            # opposite walls both ways round, neighbours once: their images coincide
            for first, second in ((0, 1), (1, 2), (2, 3), (3, 0), (0, 2), (2, 0), (1, 3), (3, 1)):
                mirrored.append(self._mirrored(mirrored[first], second))
                seen.append(self.reflection**2 * inside)
        return Images(np.array([source, *mirrored]), np.array([through, *seen]))

    def _mirrored(self, position: Array, wall: int) -> Array:
        inward = self._inward[wall]
        mirrored: Array = position - 2 * ((position - self.corners[wall]) @ inward) * inward
        return mirrored

    def _inside(self, places: Array) -> Array:
        """Return 1 for each of ``places`` before all walls of a convex room, else 0."""
        before = np.einsum("nkj,kj->nk", places[:, None] - self.corners, self._inward)
        inside: Array = (before > -_EPSILON).all(axis=1).astype(np.float64)
        return inside

    def _seen(self, source: Array, places: Array, wall: int) -> Array:
        """Return 1 for each of ``places`` that sees ``source`` in ``wall``, else 0."""
        start, end, inward = self.corners[wall], self._ends[wall], self._inward[wall]
        source_m, place_m = (source - start) @ inward, (places - start) @ inward
        span = max(float(source_m), _EPSILON) + np.maximum(place_m, 0)
        share = max(float(source_m), _EPSILON) / span
        foot = source - source_m * inward
        feet = places - place_m[:, None] * inward
        mirror = foot + (feet - foot) * share[:, None]
        along = (mirror - start) @ (end - start) / ((end - start) @ (end - start))
        before = (source_m > -_EPSILON) & (place_m > -_EPSILON)
        seen = before & (along > -_EPSILON) & (along < 1 + _EPSILON)
        hidden = self._crossed(source, mirror, wall) + self._crossed(mirror, places, wall)
        unhidden: Array = (seen & (hidden == 0)).astype(np.float64)
        return unhidden

    def _crossed(self, one: Array, other: Array, but: int | None) -> NDArray[np.intp]:
        """Return how many walls but ``but`` lie between, shape (n,); touching is not crossing."""
        one, other = np.broadcast_arrays(one, other)
        ray, wall = (other - one)[:, None], (self._ends - self.corners)[None]
        to_wall = self.corners[None] - one[:, None]
        across = ray[..., 0] * wall[..., 1] - ray[..., 1] * wall[..., 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            on_ray = (to_wall[..., 0] * wall[..., 1] - to_wall[..., 1] * wall[..., 0]) / across
            on_wall = (to_wall[..., 0] * ray[..., 1] - to_wall[..., 1] * ray[..., 0]) / across
        low, high = _EPSILON, 1 - _EPSILON
        between = (on_ray > low) & (on_ray < high) & (on_wall > low) & (on_wall < high)
        between &= np.abs(across) > _EPSILON**2
        if but is not None:
            between[:, but] = False
        crossed: NDArray[np.intp] = between.sum(axis=1)
        return crossed


@dataclass(frozen=True, slots=True, eq=False)
class Floor:
    """A plate, and the arrivals of the shoes that are worn on it.

    Attributes
    ----------
    plate
        The slab, or ground of another law.
    shoes
        Worn on it.
    laws
        Of the arrivals of each shoe.
    paths
        How far waves run from place to place.
    """

    plate: Plate | Ground
    shoes: tuple[Shoe, ...]
    laws: tuple[ArrivalLaw, ...]
    paths: UnevenFloor

    @classmethod
    def of(cls, options: RoomOptions, site: Geometry) -> Floor:
        """Return the floor; the laws reach from one end of the site to the other."""
        shoes = SHOES[options.shoe or "heel"]
        floor: Plate | Ground = plate_of(options)
        law = options.wave_law
        if law is not None and law != "plate" and law != "any":
            floor = ground_of(law, options.seed, options.speed_mps)
        paths = _paths(options, site)
        reach_m = extent_m(site) * paths.most
        return cls(floor, shoes, tuple(ArrivalLaw.of(floor, x, reach_m) for x in shoes), paths)

    @property
    def medium(self) -> Medium:
        """What a calibration with the first of the shoes would find."""
        law = self.laws[0]
        thickness_m = self.plate.thickness_m if isinstance(self.plate, Plate) else None
        return Medium(thickness_m, law.velocity_mps, law.theta_s)

    def law_of(self, shoe: Shoe) -> ArrivalLaw:
        """Return the law of one of the shoes."""
        return self.laws[self.shoes.index(shoe)]


def _paths(options: RoomOptions, site: Geometry) -> UnevenFloor:
    low, high = _corners(site)
    rng = np.random.default_rng([options.seed, 14])
    return UnevenFloor.drawn(low, high, options.uneven or 0.0, UNEVEN_M, rng)


def plate_of(options: RoomOptions) -> Plate:
    """Return the slab: concrete, its thickness from the option, the dispersion or the geometry."""
    plate = Plate()
    thickness_m = options.thickness_m
    if options.dispersion_m2s is not None:
        # a grows with the thickness
        thickness_m = plate.thickness_m * options.dispersion_m2s / plate.dispersion_m2s
    elif thickness_m is None and options.geometry is not None:
        thickness_m = options.geometry.medium.thickness_m
    if thickness_m is not None:
        plate = replace(plate, thickness_m=thickness_m)
    return plate if options.loss_s is None else replace(plate, loss_s=options.loss_s)


def extent_m(site: Geometry) -> float:
    """Return the diagonal of the rectangle around outline and sensors [m]."""
    low, high = _corners(site)
    return math.sqrt(float(((high - low) ** 2).sum()))


def _corners(site: Geometry) -> tuple[Array, Array]:
    """Return the lower left and the upper right corner of that rectangle, shape (2,) each [m]."""
    places = np.array([*site.outline, *((s.x, s.y) for s in site.sensors)], np.float64)
    return places.min(axis=0), places.max(axis=0)


@dataclass(frozen=True, slots=True, eq=False)
class Channels:
    """What each channel feels.

    Attributes
    ----------
    stations
        Places, shape (n_stations, 2) [m].
    station
        Of each channel, shape (n_channels,).
    axes
        ``x``, ``y`` or ``z`` of each channel.
    offset_s
        How late each is stamped, shape (n_channels,) [s].
    gain
        What each shows over what it feels, shape (n_channels,).
    """

    stations: Array
    station: NDArray[np.intp]
    axes: tuple[str, ...]
    offset_s: Array
    gain: Array


@dataclass(frozen=True, slots=True, eq=False)
class Wavefield:
    """Waves in the floor, as the channels feel them.

    Attributes
    ----------
    synthesis
        Of the waveforms.
    channels
        Who feels them.
    walls
        What sends them back.
    paths
        How far they run.
    mounting
        Velocity of each station's sensor over the floor's, shape (n_stations, n_frequencies), or
        None where all are fixed firmly.
    """

    synthesis: Synthesis
    channels: Channels
    walls: Walls
    paths: UnevenFloor
    mounting: Spectra | None = None

    def lead(self, strike: Strike) -> int:
        """Return the sample at which the waveforms of ``strike`` start."""
        rate = self.synthesis.rate_hz
        early = int(np.ceil(max(0.0, -float(self.channels.offset_s.min())) * rate))
        return int(strike.time_ns * rate // NS_PER_S) - _LEAD - early

    def waves(self, strike: Strike) -> Array:
        """Return what all channels feel of ``strike``, shape (n_samples, n_channels) [m/s]."""
        synthesis, frequency = self.synthesis, self.synthesis.frequency_hz
        delay_s = strike.time_ns / NS_PER_S - self.lead(strike) / synthesis.rate_hz
        force = strike.footfall.spectrum(frequency) * synthesis.sensor()
        force *= np.exp(-2j * np.pi * delay_s * frequency)
        transfer = self._transfer(np.array([strike.x_m, strike.y_m]))
        transfer *= self.channels.gain[:, None]
        if self.channels.offset_s.any():
            transfer *= np.exp(-2j * np.pi * np.multiply.outer(self.channels.offset_s, frequency))
        return synthesis.inverse(transfer, force).T

    def _transfer(self, source: Array) -> Spectra:
        """Return velocity over force, all images together, shape (n_channels, n_frequencies)."""
        channels, frequency = self.channels, self.synthesis.frequency_hz
        images = self.walls.images(source, channels.stations)
        total = np.zeros((len(channels.axes), len(frequency)), np.complex128)
        columns = {axis: [i for i, a in enumerate(channels.axes) if a == axis] for axis in "xyz"}
        for position, gains in zip(images.places, images.gains, strict=True):
            away = channels.stations - position
            distance = self.paths.lengths_m(position, channels.stations)
            vertical = self._mounted(self.synthesis.plate.response(distance, frequency), gains)
            total[columns["z"]] += vertical[channels.station[columns["z"]]]
            if columns["x"] or columns["y"]:
                radial = self.synthesis.plate.radial(distance, frequency, self._lever_m)
                radial = self._mounted(radial, gains)
                direction = away / np.maximum(np.hypot(*away.T), 1e-9)[:, None]
                for part, axis in enumerate("xy"):
                    at = channels.station[columns[axis]]
                    total[columns[axis]] += direction[at, part, None] * radial[at]
        return total

    def _mounted(self, spectra: Spectra, gains: Array) -> Spectra:
        spectra *= gains[:, None]
        if self.mounting is not None:
            spectra *= self.mounting
        return spectra

    @property
    def _lever_m(self) -> float:
        return float(
            _RADIAL / np.sqrt(2 * np.pi * _RADIAL_HZ / self.synthesis.plate.dispersion_m2s)
        )


def synthesis_of(plate: WaveMedium, rate_hz: float, reach_m: float, spread_s: float) -> Synthesis:
    """Return the synthesis of waveforms long enough for waves that run ``reach_m``.

    Parameters
    ----------
    plate
        The floor.
    rate_hz
        Sampling rate.
    reach_m
        Of the farthest image [m].
    spread_s
        Between the earliest and the latest clock [s].
    """
    longest_s = max(0.4, 0.3 + reach_m / plate.slowest_mps)
    return Synthesis.lasting(plate, rate_hz, longest_s + spread_s)


@dataclass(frozen=True, slots=True, eq=False)
class RoomSignal:
    """The samples of a room, generated a second at a time; iterating again gives the same.

    Attributes
    ----------
    stream
        Its channels' scales are counts of a digitiser.
    seed
        Of the noise.
    duration_s
        Length [s].
    strikes
        In order of time.
    field
        The waves.
    sigma_mps
        Mean standard deviation of the noise [m/s]; each channel has 0.8 to 1.2 of it.
    dead
        Channels that give 0, shape (n_channels,).
    rails
        Most counts of each channel, shape (n_channels,).
    """

    stream: Stream
    seed: int
    duration_s: float
    strikes: Sequence[Strike]
    field: Wavefield
    sigma_mps: float
    dead: NDArray[np.bool_]
    rails: Array

    def __iter__(self) -> Iterator[SignalBlock]:
        rate = self.stream.rate_hz
        total, size = round(self.duration_s * rate), round(rate)
        length = self.field.synthesis.samples
        noise = self._noise()
        pending = np.zeros((size + length, len(self.stream.channels)))
        coming = list(self.strikes)
        for first in range(0, total, size):
            while coming and self.field.lead(coming[0]) < first + size:
                pending_from = self.field.lead(coming[0]) - first
                pending[pending_from : pending_from + length] += self.field.waves(coming.pop(0))
            count = min(size, total - first)
            counts = (pending[:count] + next(noise)[:count]) / self.stream.scales
            samples = np.clip(np.rint(counts), -self.rails - 1, self.rails).astype(np.int16)
            samples[:, self.dead] = 0
            yield SignalBlock(self.stream, START_NS, first, samples)
            pending[:length] = pending[size:].copy()
            pending[length:] = 0.0

    def _noise(self) -> Iterator[Array]:
        """Give a second of white noise and hum at a time, shape (n_samples, n_channels) [m/s]."""
        rng = np.random.default_rng([self.seed, 2])
        n_channels, size = len(self.stream.channels), round(self.stream.rate_hz)
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


#: Chosen by judgement: half a step.
_BEYOND_NS = NS_PER_S // 4  # a walking span before its first step and after its last


def labels_of(
    strikes: Sequence[Strike], site: Geometry, floor: Floor, faults: Faults
) -> tuple[Label, ...]:
    """Return the labels in order of time."""
    labels = list(_spans(strikes))
    places = np.array([(s.x, s.y) for s in site.sensors])
    names = [s.channel for s in site.sensors]
    for strike in strikes:
        if strike.disturbs:
            continue
        labels.append(_struck(strike))
        distance = floor.paths.lengths_m(np.array([strike.x_m, strike.y_m]), places)
        late_s = floor.law_of(strike.footfall.shoe)(distance) + faults.offset_s
        for name, delay_ns, dead in zip(names, late_s * NS_PER_S, faults.dead, strict=True):
            if not dead:
                time_ns = START_NS + strike.time_ns + round(delay_ns)
                target = strike.target
                labels.append(Label(time_ns, "pick", channel=name, author=AUTHOR, target=target))
    return tuple(sorted(labels, key=lambda x: (x.time_ns, x.kind, x.channel)))


def _struck(strike: Strike) -> Label:
    return Label(
        START_NS + strike.time_ns,
        "step" if strike.foot else "impact",
        x_m=strike.x_m,
        y_m=strike.y_m,
        label=strike.foot,
        author=AUTHOR,
        target=strike.target,
    )


def _spans(strikes: Sequence[Strike]) -> Iterator[Label]:
    """Give the walking span of each walker."""
    for target in dict.fromkeys(x.target for x in strikes):
        times = [x.time_ns for x in strikes if x.target == target and x.foot and not x.disturbs]
        if times:
            start_ns, end_ns = START_NS + times[0] - _BEYOND_NS, START_NS + times[-1] + _BEYOND_NS
            yield Label(start_ns, "walking", end_ns, author=AUTHOR, target=target)


@dataclass(frozen=True, slots=True, eq=False)
class Faults:
    """What is wrong with each channel; all shapes are (n_channels,).

    Attributes
    ----------
    offset_s
        How late the samples are stamped [s]: the channel shows at t what it felt at t - offset.
    dead
        Gives 0 all the time.
    clipped
        Has too much gain.
    """

    offset_s: NDArray[np.float64]
    dead: NDArray[np.bool_]
    clipped: NDArray[np.bool_]

    @classmethod
    def of(cls, options: RoomOptions, site: Geometry) -> Faults:
        """Return the faults of the sensors that the options name; a name stands for its station.

        Raises
        ------
        SimulationError
            Where an option names a sensor that the site does not have.
        """
        offset_s = _clocks(options, site)
        for name, value in options.clock_offset_s:
            offset_s[_channels(site, "clock offset", name)] = value
        dead, clipped = (np.zeros(len(site.sensors), np.bool_) for _ in range(2))
        for flags, option, names in (
            (dead, "dead", options.dead),
            (clipped, "clipped", options.clipped),
        ):
            for name in names:
                flags[_channels(site, option, name)] = True
        return cls(offset_s, dead, clipped)

    def described(self, site: Geometry) -> dict[str, dict[str, str]]:
        """Return the metadata of the clocks: each channel's offset [s], none where all are 0."""
        if not self.offset_s.any():
            return {}
        offsets = zip(site.sensors, self.offset_s.tolist(), strict=True)
        return {"clock_offset_s": {sensor.channel: repr(value) for sensor, value in offsets}}


def _clocks(options: RoomOptions, site: Geometry) -> NDArray[np.float64]:
    """Return the offset of each channel's clock [s]: what the geometry knows, and a random part.

    Channels of a station share the random part, which is drawn to the microsecond.
    """
    rng = np.random.default_rng([options.seed, 6])
    stations = list(dict.fromkeys(s.name for s in site.sensors))
    spread_s = np.round(rng.normal(0, options.clock_spread_s or 0.0, len(stations)), 6)
    of_station = dict(zip(stations, spread_s.tolist(), strict=True))
    offset_s = [s.clock_offset_s + of_station[s.name] for s in site.sensors]
    return np.clip(np.array(offset_s, np.float64), -LATEST_S, LATEST_S)


def _channels(site: Geometry, option: str, name: str) -> list[int]:
    indices = [i for i, s in enumerate(site.sensors) if name in (s.name, s.channel)]
    if not indices:
        names = ", ".join(dict.fromkeys(s.name for s in site.sensors))
        raise refused(option, f"one of {names}", repr(name))
    return indices
