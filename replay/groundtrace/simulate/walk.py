"""A person walking, as sensors they wear see it.

:mod:`.gait` says when which foot touches the floor, where the body goes, and how the place moves
where the sensor is worn. What a sensor measures follows from the motion: its accelerometer feels
the acceleration plus gravity in its own axes, its gyroscope the rotation between samples, its
magnetometer the field of the earth and of magnets there. Routes are drawn at random: legs and
turns, stops, and steps of other types on the way.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import cycle, pairwise
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from groundtrace_codecs.events import Label
from groundtrace_codecs.signals import G0_MPS2, NS_PER_S, Channel, SignalBlock, Stream

from ..errors import SimulationError
from .gait import (
    LATERAL,
    Bout,
    Idle,
    Plan,
    Turn,
    WalkOptions,
    person,
    plan,
    sensor_motion,
    step_asymmetry,
)
from .recording import AUTHOR, START_NS, Simulation, described

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from numpy.typing import NDArray
    from scipy.spatial.transform import Rotation

    from .gait import Activity, Foot, Motion, Person, RouteName, StepType, Stride

    Array = NDArray[np.float64]


def simulate_walk(options: WalkOptions | None = None) -> Simulation:
    """Simulate a walk with worn sensors.

    The truth: ``step`` per initial contact with place and foot, or with ``types`` its type and
    the foot as note; ``trailing`` for the second contact of each side step then; ``heading``
    [rad], where the body faces; ``walking`` and ``disturbed`` spans (value: largest added field
    [T]), ``idle`` spans, and ``waypoint`` where the person starts, turns and stops.

    Raises
    ------
    SimulationError
        Where an option is out of its range.
    """
    walker = _walker((options or WalkOptions()).resolved())
    return Simulation(
        sources=[(s.stream, "f64le", s) for s in walker.samples()],
        geometry=None,
        labels=walk_labels(walker),
        metadata=described("walk", walker.options),
    )


def _walker(options: WalkOptions) -> Walker:
    """Return who walks where, for options with their path chosen."""
    who = person(options)
    if options.standard and options.duration_s is not None:
        duration_s = options.duration_s
        walk = plan(duration_s, np.random.default_rng([options.seed, 1]))
    else:
        walk, duration_s = route_plan(options, who)
    return Walker(options, walk, who, duration_s, disturbances(options, walk, duration_s))


_T = TypeVar("_T")
#: A turn to the left [rad]. Source: definition.
_LEFT = np.pi / 2
#: Legs and the turns at their ends [m, rad]; the last turn leads into the next lap. Source: EPFL
#: for "epfl", 260 m round; the others chosen by judgement: a corridor, a corner, a building.
LAPS: dict[RouteName, tuple[tuple[float, float], ...]] = {
    "straight": ((40.0, np.pi),),
    "l": ((20.0, _LEFT), (15.0, np.pi)),
    "loop": ((20.0, _LEFT), (12.0, _LEFT), (20.0, _LEFT), (12.0, _LEFT)),
    "epfl": ((100.0, _LEFT), (30.0, _LEFT), (100.0, _LEFT), (30.0, _LEFT)),
}
#: Chosen by judgement: long enough to level a sensor, and to see a track end; nothing that people
#: do between walks lasts longer.
_STILL_S = (4.0, 6.0)  # standing at the start, and at the end
_LONGEST_S: dict[Activity, float] = {"sit": 12.0, "reach": 5.0, "handle": 8.0, "ride": 30.0}
_OTHERS: tuple[StepType, ...] = ("backward", "left", "right")


@dataclass(frozen=True, slots=True)
class Stretch:
    """A walk without a stop, and what follows it.

    Attributes
    ----------
    kind
        Type of its steps.
    legs
        Lengths [m] and the turns at their ends [rad]; the last has none.
    pause_s
        Standing after it [s].
    activity
        What is done then, or None.
    """

    kind: StepType
    legs: tuple[tuple[float, float], ...]
    pause_s: float
    activity: Activity | None = None

    @property
    def length_m(self) -> float:
        """Length of all legs [m]."""
        return sum(length for length, _ in self.legs)


def route_plan(options: WalkOptions, person: Person) -> tuple[Plan, float]:
    """Return the plan of a walk along ``options.path``, and its length [s]."""
    rng = np.random.default_rng([options.seed, 12])
    bouts: list[Bout] = []
    turns: list[Turn] = []
    idles: list[Idle] = []
    now_s = float(rng.uniform(*_STILL_S))
    for stretch in _stretches(options, person, rng):
        bout = _bout(stretch, person, now_s, rng)
        turns += _turns_between(stretch, bout)
        bouts.append(bout)
        now_s = bout.span_s[1] + stretch.pause_s
        if stretch.activity is not None:
            idles.append(Idle(bout.span_s[1] + 0.8, now_s - 0.8, stretch.activity))
        if options.duration_s is not None and now_s >= options.duration_s:
            break
    if options.duration_s is None:
        return Plan(tuple(bouts), tuple(turns), (), tuple(idles)), float(np.ceil(now_s))
    return _cut(Plan(tuple(bouts), tuple(turns), (), tuple(idles)), options.duration_s)


def _cut(plan: Plan, duration_s: float) -> tuple[Plan, float]:
    """Leave out what begins after the end."""
    shortened = Plan(
        tuple(b for b in plan.bouts if b.span_s[0] < duration_s),
        tuple(t for t in plan.turns if t.start_s < duration_s),
        (),
        tuple(i for i in plan.idles if i.start_s < duration_s),
    )
    return shortened, duration_s


def _stretches(options: WalkOptions, person: Person, rng: np.random.Generator) -> Iterator[Stretch]:
    """Yield walks: one lap, or more than enough where the length is given.

    Only the random path stops by itself; other types and idle time make stops on any path.
    """
    stopping = options.types or options.with_idle or options.path == "random"
    others = _in_turn(_OTHERS, rng) if options.types else None
    pauses = _pauses(options, rng)
    legs: list[tuple[float, float]] = []
    for length_m, turn_rad in _legs(options, person, rng):
        rest_m = length_m
        while stopping and rest_m > 8.0 and rng.random() < 0.8:
            part_m = min(float(rng.uniform(4.0, 12.0)), rest_m - 4.0)
            rest_m -= part_m
            yield Stretch("forward", (*legs, (part_m, 0.0)), *next(pauses))
            legs = []
            if others is not None:
                yield _other(next(others), person, rng, *next(pauses))
        legs.append((rest_m, turn_rad))
        if turn_rad == 0.0:
            yield Stretch("forward", tuple(legs), float(rng.uniform(*_STILL_S)))
            legs = []


def _legs(
    options: WalkOptions, person: Person, rng: np.random.Generator
) -> Iterator[tuple[float, float]]:
    """Yield legs and the turns at their ends; the last has none."""
    stride = person.strides["forward"]
    speed_mps = stride.cadence_hz * stride.length_m
    enough_m = 0.0 if options.duration_s is None else 1.3 * speed_mps * options.duration_s
    lap = LAPS.get(options.path) if options.path else None
    for index, (length_m, turn_rad) in enumerate(_random_legs(rng) if lap is None else cycle(lap)):
        enough_m -= length_m
        ended = enough_m <= 0 and (lap is None or (index + 1) % len(lap) == 0)
        yield length_m, 0.0 if ended else turn_rad
        if ended:
            return


def _random_legs(rng: np.random.Generator) -> Iterator[tuple[float, float]]:
    while True:
        angle = float(rng.choice((-1, 1)) * np.radians(rng.uniform(30, 120)))
        yield float(rng.uniform(5, 20)), angle


def _in_turn(choices: tuple[_T, ...], rng: np.random.Generator) -> Iterator[_T]:
    """Yield the choices in random order, each as often as the rest."""
    while True:
        yield from (choices[i] for i in rng.permutation(len(choices)))


def _other(
    kind: StepType,
    person: Person,
    rng: np.random.Generator,
    pause_s: float,
    activity: Activity | None,
) -> Stretch:
    """Return 3 to 7 side steps or 5 to 10 backward ones."""
    steps = 2 * int(rng.integers(3, 8)) if kind in LATERAL else int(rng.integers(5, 11))
    length_m = (steps - 1.5) * person.strides[kind].length_m
    return Stretch(kind, ((length_m, 0.0),), pause_s, activity)


def _pauses(
    options: WalkOptions, rng: np.random.Generator
) -> Iterator[tuple[float, Activity | None]]:
    """Yield how long stops take, and what is done in them: in every second one, if anything."""
    activities = _in_turn(tuple(_LONGEST_S), rng)
    while True:
        if options.with_idle and rng.random() < 0.5:
            activity = next(activities)
            yield float(rng.uniform(0.6, 1.0)) * _LONGEST_S[activity], activity
        else:
            yield float(rng.uniform(1.0, 4.0)), None


def _bout(stretch: Stretch, person: Person, start_s: float, rng: np.random.Generator) -> Bout:
    """Return the steps of a stretch: its length is walked exactly, with whole steps."""
    stride = person.strides[stretch.kind]
    # The body starts and stops within 1.5 steps each, see Bout.ground_speed.
    count = max(4, round(stretch.length_m / stride.length_m + 1.5))
    if stretch.kind in LATERAL:
        count += count % 2
    gap_s = _gaps(stride, person, count, rng)
    contact_s = np.round(start_s + gap_s.mean() / 2 + np.cumsum(gap_s) - gap_s[0], 6)
    first = _first_foot(stretch.kind, rng)
    strength = stride.strength * (1 + 0.08 * rng.standard_normal(count))
    strength *= step_asymmetry(stretch.kind, first, count, person.manner)
    strength[[0, -1]] *= 0.7
    walked_s = contact_s[-1] - contact_s[0] - 0.5 * np.diff(contact_s).mean()
    return Bout(contact_s, strength, stretch.length_m / float(walked_s), stretch.kind, first)


def _gaps(stride: Stride, person: Person, count: int, rng: np.random.Generator) -> np.ndarray:
    """Draw the times between contacts [s]: steps differ, and the pace wanders slowly."""
    steps = person.unsteady * np.clip(rng.standard_normal(count), -3, 3)
    wander = 0.03 * np.sin(2 * np.pi * (np.arange(count) / rng.uniform(15, 40) + rng.random()))
    gaps: np.ndarray = (1 + steps + wander) / stride.cadence_hz
    return gaps


def _first_foot(kind: StepType, rng: np.random.Generator) -> Foot:
    """Return the foot that starts: to the side, the one of that side leads."""
    drawn: Foot = "left" if rng.random() < 0.5 else "right"
    if kind == "left" or kind == "right":
        return kind
    return drawn


def _turns_between(stretch: Stretch, bout: Bout) -> Iterator[Turn]:
    """Yield the turns between the legs: three steps for a right angle, two at least."""
    walked_m = np.cumsum([length for length, _ in stretch.legs])[:-1]
    for done_m, (_, angle) in zip(walked_m.tolist(), stretch.legs, strict=False):
        length_s = bout.step_s * max(2.0, 3.0 * abs(angle) / (np.pi / 2))
        middle_s = bout.span_s[0] + 0.75 * bout.step_s + done_m / bout.speed_mps
        yield Turn(middle_s - length_s / 2, length_s, angle)


#: The motion of a band-limited sensor is computed at this rate at least [Hz]. Chosen by judgement:
#: six times what a contact shakes with.
_FINE_HZ = 200.0
#: Last bit of an accelerometer of 8 g and a gyroscope of 1000 deg/s, of 16 bits. Source:
#: definition.
_LSB = (8 * G0_MPS2 / 32768, np.radians(1000) / 32768)
#: Where x and y are 0: a car park of the EPFL [deg, deg, m]. Chosen by judgement: any place would
#: do; the radius of the earth is that of WGS 84, the noise that of a receiver in the open.
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
    decay = np.exp(-1 / 60.0)
    error = np.empty((len(track), 3))
    now = wander * rng.standard_normal(3)
    for row in error:
        row[:] = now + white * rng.standard_normal(3)
        now = decay * now + wander * np.sqrt(1 - decay**2) * rng.standard_normal(3)
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


#: Rate of a sensor, and time between true headings. Chosen by judgement: as usual inertial sensors
#: have.
_RATE_HZ = 200.0
_HEADING_S = 0.1


def walk_labels(walker: Walker) -> tuple[Label, ...]:
    """Return the truth in order of time, nothing of it after the end."""
    truth = _Truth(walker)
    labels = [*truth.bouts(), *truth.turns(), *truth.disturbed(), *truth.headings()]
    labels += [
        Label(_ns(i.start_s), "idle", _ns(i.end_s), label=i.activity, author=AUTHOR)
        for i in walker.plan.idles
    ]
    end_ns = _ns(float(truth.time_s[-1]))
    retained = [_until(end_ns, x) for x in labels if x.time_ns <= end_ns]
    return tuple(sorted(retained, key=lambda x: (x.time_ns, x.kind, x.channel)))


class _Truth:
    """Where the body is and faces, on a fine grid."""

    def __init__(self, walker: Walker) -> None:
        self.walker = walker
        self.time_s = grid(walker.duration_s, _RATE_HZ)
        self.heading = walker.plan.heading(self.time_s)
        self.track = np.ascontiguousarray(walker.plan.track(self.time_s).T)

    def at(self, moment_s: float, kind: str, label: str = "", note: str = "") -> Label:
        """Return a label with the body's place."""
        x, y = (round(float(np.interp(moment_s, self.time_s, p)), 4) for p in self.track)
        return Label(_ns(moment_s), kind, None, x, y, label=label, author=AUTHOR, note=note)

    def heading_at(self, moment_s: float) -> Label:
        """Return where the body faces."""
        value = round(float(np.interp(moment_s, self.time_s, self.heading)), 4)
        x, y = (round(float(np.interp(moment_s, self.time_s, p)), 4) for p in self.track)
        return Label(_ns(moment_s), "heading", None, x, y, value, author=AUTHOR)

    def bouts(self) -> Iterator[Label]:
        """Yield walking spans, where they start and stop, and their steps."""
        for bout in self.walker.plan.bouts:
            start_s, end_s = bout.span_s
            yield self.at(start_s, "waypoint", "start")
            yield self.at(end_s, "waypoint", "stop")
            yield Label(_ns(start_s), "walking", _ns(end_s), author=AUTHOR)
            yield from self.steps(bout)

    def steps(self, bout: Bout) -> Iterator[Label]:
        """Yield a walk's steps; the second contact of a side step is not one of its own."""
        for index, contact_s in enumerate(bout.contact_s.tolist()):
            foot = bout.foot(index)
            if not self.walker.options.types:
                yield self.at(contact_s, "step", foot)
            elif bout.kind in LATERAL and index % 2:
                yield self.at(contact_s, "trailing", bout.kind, f"{foot} foot")
            else:
                yield self.at(contact_s, "step", bout.kind, f"{foot} foot")

    def headings(self) -> Iterator[Label]:
        """Yield headings: with each step of the bundled walk, else ten times a second."""
        moments = np.arange(0.0, self.walker.duration_s, _HEADING_S)
        if self.walker.options.standard:
            moments = np.concatenate([np.empty(0), *(b.contact_s for b in self.walker.plan.bouts)])
        yield from (self.heading_at(moment_s) for moment_s in moments.tolist())

    def turns(self) -> Iterator[Label]:
        """Yield the corners: where the body is in the middle of each turn."""
        for turn in self.walker.plan.turns:
            yield self.at(turn.start_s + turn.length_s / 2, "waypoint", "turn")

    def disturbed(self) -> Iterator[Label]:
        """Yield the spans in which the field differs from the earth's by 2 uT or more."""
        extra_t = np.linalg.norm(self.walker.disturbing_field(self.time_s), axis=1)
        inside = np.concatenate(([False], extra_t >= DISTURBED_T, [False]))
        edges = np.flatnonzero(np.diff(inside.astype(np.int8)))
        for first, last in edges.reshape(-1, 2).tolist():
            most_t = round(float(extra_t[first:last].max()), 8)
            span_s = float(self.time_s[first]), last / _RATE_HZ
            yield Label(_ns(span_s[0]), "disturbed", _ns(span_s[1]), value=most_t, author=AUTHOR)


def _until(end_ns: int, label: Label) -> Label:
    """Return the label with a span that ends within the recording."""
    if label.end_ns is None or label.end_ns <= end_ns:
        return label
    return replace(label, end_ns=end_ns)


def _ns(moment_s: float) -> int:
    return START_NS + round(moment_s * NS_PER_S)


#: East, north, up [T]: of the bundled recording, and 48 uT with a dip of 63 degrees. Chosen by
#: judgement: fields of middle latitudes, as of IGRF-13.
_BUNDLED_T = np.array((0.0, 20e-6, -44e-6))
_EARTH_T = 48e-6 * np.array((0.0, np.cos(np.radians(63.0)), -np.sin(np.radians(63.0))))
#: From this on the field counts as disturbed [T]. Chosen by judgement: 4 % of the earth's field.
DISTURBED_T = 2e-6
#: Strength of disturbances [T], and how far they reach [m]. Chosen by judgement: doors and cars;
#: radiators and reinforcement.
_STRONG_T, _WEAK_T = (10e-6, 60e-6), (3e-6, 6e-6)
_WIDE_M = (2.0, 10.0)
_Group = tuple[int, tuple[float, float], tuple[float, float]]
#: Of the loop of EPFL: how many, how strong, between which places along it [m]: weak ones on the
#: first straight, strong ones on the second. Chosen by judgement, after the walk of the document.
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


def disturbing_field(
    sources: tuple[Disturbance, ...], along_m: Array, lap_m: float | None
) -> Array:
    """Return what disturbs the field after ``along_m`` (n,) metres of path, (n, 3) [T].

    A disturbance rises and falls as a squared cosine of the path.
    """
    field = np.zeros((len(along_m), 3))
    along_m = along_m if lap_m is None else along_m % lap_m
    for one in sources:
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


#: Steps further apart belong to two walks [s]. Chosen by judgement: no step is as slow.
_STOP_S = 1.5
#: Length of a step where the places are not known [m]. Chosen by judgement: a usual step.
_STEP_M = 0.6
_LEAST = 4


@dataclass(frozen=True, slots=True)
class Walked:
    """A walk that was recorded.

    Attributes
    ----------
    name
        Of the recording.
    steps
        Its steps, in order of time.
    start_ns, end_ns
        Of the recording [ns].
    """

    name: str
    steps: tuple[Label, ...]
    start_ns: int
    end_ns: int


@dataclass(frozen=True, slots=True)
class ClockError:
    """How a simulated clock is wrong: ahead at the recording's start [s], and fast [1e-6]."""

    ahead_s: float = 0.0
    drift_ppm: float = 0.0


def simulate_same_walk(
    walked: Walked, options: WalkOptions | None = None, clock: ClockError | None = None
) -> Simulation:
    """Simulate what a worn sensor records of a walk that another recording has.

    Contacts are those of the recording, in time and in foot; the body goes along the line between
    the feet. The sensor records as long as the recording.

    Parameters
    ----------
    walked
        The walk: one person's steps.
    options
        Of the person and the sensor; path and length are the recording's.
    clock
        How the sensor's clock is wrong.

    Raises
    ------
    SimulationError
        Where there are fewer than 4 steps in a row, the steps are those of several people, or an
        option is out of its range.
    """
    clock = clock or ClockError()
    who = {label.target for label in walked.steps}
    if len(who) > 1:
        raise SimulationError(f"{walked.name}: expected one walker, found {len(who)}")
    speed = 1 + clock.drift_ppm * 1e-6
    duration_s = (walked.end_ns - walked.start_ns) / NS_PER_S * speed
    chosen = replace(options or WalkOptions(), duration_s=duration_s).resolved()
    plan = _plan(walked, speed)
    walker = Walker(
        chosen, plan, person(chosen), duration_s, disturbances(chosen, plan, duration_s)
    )
    # the line bends at each step a little: none of these is a place to turn at
    labels = [x for x in walk_labels(walker) if (x.kind, x.label) != ("waypoint", "turn")]
    labels = _placed(labels, walked)
    later_ns = walked.start_ns - START_NS + round(clock.ahead_s * NS_PER_S)
    metadata = described("walk", chosen)
    metadata["simulation"] |= {
        "steps_of": walked.name,
        "clock_ahead_s": str(clock.ahead_s),
        "clock_drift_ppm": str(clock.drift_ppm),
    }
    return Simulation(
        sources=[(s.stream, "f64le", _Later(s, later_ns)) for s in walker.samples()],
        geometry=None,
        labels=tuple(label.later(later_ns) for label in labels),
        metadata=metadata,
    )


@dataclass(frozen=True, slots=True)
class _Later:
    """Blocks some time later."""

    blocks: Iterable[SignalBlock]
    by_ns: int

    def __iter__(self) -> Iterator[SignalBlock]:
        for block in self.blocks:
            yield replace(block, anchor_ns=block.anchor_ns + self.by_ns)


def _plan(walked: Walked, speed: float) -> Plan:
    """Return the walks between stops, and the turns of the line between the feet."""
    steps = walked.steps
    times = np.array([(s.time_ns - walked.start_ns) / NS_PER_S * speed for s in steps])
    edges = [0, *(np.flatnonzero(np.diff(times) > _STOP_S) + 1).tolist(), len(times)]
    spans = [slice(a, b) for a, b in pairwise(edges) if b - a >= _LEAST]
    if not spans:
        raise SimulationError(
            f"{walked.name}: expected {_LEAST} steps in a row or more, found {len(times)} steps"
        )
    places = _middle(steps)
    bouts: list[Bout] = []
    turns: list[Turn] = []
    for span in spans:
        contact_s, positions = times[span], places[span]
        walked_m = float(np.hypot(*np.diff(positions, axis=0).T).sum()) or _STEP_M * len(positions)
        moving_s = float(contact_s[-1] - contact_s[0]) - 0.5 * float(np.diff(contact_s).mean())
        first: Foot = "right" if steps[span.start].label == "right" else "left"
        strength = np.ones(len(contact_s))
        strength[[0, -1]] = 0.7
        speed_mps = walked_m / moving_s
        bouts.append(Bout(contact_s, strength, speed_mps, "forward", first))
        turns += _turns(contact_s, positions, turns)
    return Plan(tuple(bouts), tuple(turns))


def _middle(steps: Sequence[Label]) -> NDArray[np.float64]:
    """Return where the body is at each step, between the feet, shape (n, 2) [m]."""
    if any(s.x_m is None or s.y_m is None for s in steps):
        along = np.arange(len(steps)) * _STEP_M
        return np.stack([along, np.zeros(len(steps))], axis=1)
    feet = np.array([(s.x_m, s.y_m) for s in steps], np.float64)
    middle = feet.copy()
    middle[1:] = (feet[1:] + feet[:-1]) / 2
    middle[0] += middle[1] - feet[1] if len(feet) > 1 else 0.0
    return middle


def _turns(
    contact_s: NDArray[np.float64], positions: NDArray[np.float64], before: Sequence[Turn]
) -> list[Turn]:
    """Return a turn at each step at which the line bends, and one that faces its start."""
    legs = np.diff(positions, axis=0)
    course = np.arctan2(legs[:, 1], legs[:, 0])
    facing = sum(turn.angle_rad for turn in before)
    turns = []
    step_s = float(np.diff(contact_s).mean())
    for k, angle in enumerate(course.tolist()):
        bend = float((angle - facing + np.pi) % (2 * np.pi) - np.pi)
        if abs(bend) > 1e-3:
            # before a walk begins its turn is over: nobody turns on the spot at its first step
            at_s = contact_s[0] - step_s if k == 0 else contact_s[k]
            turns.append(Turn(float(at_s) - step_s / 2, step_s, bend))
            facing += bend
    return turns


def _placed(labels: Sequence[Label], walked: Walked) -> list[Label]:
    """Return labels where the recording has the walk, not from the origin."""
    first, there = next((x for x in labels if x.kind == "step"), None), walked.steps[0]
    if first is None or there.x_m is None or first.x_m is None:
        return list(labels)
    x_m, y_m = there.x_m - first.x_m, (there.y_m or 0.0) - (first.y_m or 0.0)
    return [
        replace(x, x_m=round(x.x_m + x_m, 4), y_m=round((x.y_m or 0.0) + y_m, 4))
        if x.x_m is not None
        else x
        for x in labels
    ]
