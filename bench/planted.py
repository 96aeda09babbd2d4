"""Recordings with one planted cause: simulated ones whose signal or truth is edited at one place.

A :class:`Take` is a recording in memory. A plant changes a copy of it and says what should be
named, at which moment, and under which settings the step would be found although the plant is
there.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from groundtrace.simulate.gait import WalkOptions
from groundtrace.simulate.recording import START_NS
from groundtrace.simulate.room import simulate_room
from groundtrace.simulate.room_plan import RoomOptions
from groundtrace.simulate.walk import simulate_walk
from groundtrace_codecs.events import SIMULATOR, Label
from groundtrace_codecs.geometry import Geometry, Sensor
from groundtrace_codecs.signals import NS_PER_S, Channel, SignalBlock, Stream
from groundtrace_codecs.writer import write_recording

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray

    from groundtrace.pipeline.results import Evidence
    from groundtrace.simulate.recording import Simulation

Rng = np.random.Generator


@dataclass
class Take:
    """A recording in memory.

    Attributes
    ----------
    samples
        Shape (n, channels), as stored.
    holes
        Spans of samples that are not recorded.
    """

    stream: Stream
    sample_format: str
    samples: NDArray[np.float64]
    start_ns: int
    labels: list[Label]
    geometry: Geometry | None = None
    holes: list[tuple[int, int]] = field(default_factory=list)

    @classmethod
    def of(cls, simulation: Simulation) -> Take:
        """Take the first stream of a simulation; all of it is scored."""
        stream, sample_format, blocks = simulation.sources[0]
        block_list = list(blocks)
        samples = np.concatenate([block.samples for block in block_list]).astype(float)
        labels = [x for x in simulation.labels if x.kind in ("step", "pick", "impact")]
        return cls(
            stream, sample_format, samples, block_list[0].start_ns, labels, simulation.geometry
        )

    def copy(self) -> Take:
        """Return one that can be changed alone."""
        take = copy.copy(self)
        take.samples, take.labels = self.samples.copy(), list(self.labels)
        take.holes = list(self.holes)
        return take

    @property
    def rate_hz(self) -> float:
        """Samples per second."""
        return self.stream.rate_hz

    def index(self, time_ns: float) -> int:
        """Return the sample at a time."""
        return round((time_ns - self.start_ns) / NS_PER_S * self.rate_hz)

    def count(self, length_s: float) -> int:
        """Return how many samples a time has."""
        return round(length_s * self.rate_hz)

    def steps(self) -> list[Label]:
        """Return the true steps in the order of time."""
        return sorted(x for x in self.labels if x.kind == "step")

    def arrivals(self, channel: str) -> list[Label]:
        """Return the true arrivals of a channel in the order of time."""
        return sorted(x for x in self.labels if x.kind == "pick" and x.channel == channel)

    def write(self, path: Path) -> None:
        """Write it as a recording."""
        samples = self.samples
        if self.sample_format == "i16le":
            samples = np.clip(np.rint(samples), -32768, 32767).astype(np.int16)
        edges = [0, *(edge for hole in sorted(self.holes) for edge in hole), len(samples)]
        blocks = [
            SignalBlock(self.stream, self.start_ns, a, samples[a:b])
            for a, b in zip(edges[::2], edges[1::2], strict=True)
            if b > a
        ]
        write_recording(
            path,
            [(self.stream, self.sample_format, blocks)],
            geometry=self.geometry,
            labels=tuple(sorted(self.labels)),
            force=True,
        )


@dataclass
class Planted:
    """A take with one cause planted.

    Attributes
    ----------
    take
        What is replayed.
    time_ns, channel
        Where ``why`` is asked; the channel of a pick, or of a sensor.
    opened
        Settings that would find what is missed although the plant is there; None where the plant
        itself shows what it hides. ``tight`` are those that must not.
    settings
        Further settings of the replay.
    origin_ns
        The step's time without the plant, where that is another; 0 where it is the same.
    expected
        What is to be named, where the plant has no word of its own.
    state
        What must have become of the pick for the plant to have acted: ``early`` where what comes
        before the arrival was picked, ``missed`` where nothing answers it, ``unseen`` where there
        is not even a candidate for it, though the decision function is above the floor; empty
        stands for any.
    """

    take: Take
    time_ns: int
    channel: str = ""
    opened: tuple[str, ...] | None = None
    tight: tuple[str, ...] | None = None
    settings: tuple[str, ...] = ()
    origin_ns: int = 0
    expected: str = ""
    state: str = ""


@dataclass(frozen=True)
class Clean:
    """A take without a plant, and what its replay found.

    Attributes
    ----------
    found_ns
        Each true step's detection, those that are missed left out, by the step's time.
    evidence
        What was decided.
    """

    take: Take
    found_ns: dict[int, int]
    evidence: Evidence

    def inner(self) -> list[int]:
        """Return the steps that are found in time, as are those before and after each."""
        times = [x.time_ns for x in self.take.steps()]
        good = [abs(self.found_ns.get(t, 0) - t) <= 80_000_000 for t in times]
        return [
            i
            for i in range(2, len(times) - 2)
            if all(good[i - 1 : i + 2]) and times[i + 1] - times[i - 1] < 2.2 * NS_PER_S
        ]

    def step_ns(self, number: int) -> int:
        """Return half of the time between the steps before and after one."""
        times = [x.time_ns for x in self.take.steps()]
        return (times[number + 1] - times[number - 1]) // 2


def walk(seed: int, placement: str) -> Take:
    """Return a walk of 30 s of a person drawn from the seed."""
    options = WalkOptions(
        seed=seed,
        person=seed,
        placement=placement,  # type: ignore[arg-type]
        path="random",
        duration_s=30.0,
    )
    return Take.of(simulate_walk(options))


def room(seed: int, channels: tuple[int, int] = (4, 9)) -> Take:
    """Return twelve steps in a room, on a floor and with shoes that are drawn from the seed."""
    count = int(np.random.default_rng(seed).integers(channels[0], channels[1] + 1))
    options = RoomOptions(
        seed=seed, steps=12, rate_hz=5000.0, channels=count, random=True, walls=0.0, snr=60.0
    )
    return Take.of(simulate_room(options))


def room_for_places(seed: int) -> Take:
    """Return twelve steps in a room where onsets are picked well: heels, and 20 kHz."""
    rng = np.random.default_rng(seed)
    options = RoomOptions(
        seed=seed,
        steps=12,
        channels=int(rng.integers(7, 10)),
        side_m=(float(rng.uniform(4.5, 7.0)), float(rng.uniform(4.5, 7.0))),
        path=("u", "l", "circle")[int(rng.integers(3))],
        thickness_m=float(rng.uniform(0.16, 0.24)),
    )
    return Take.of(simulate_room(options))


def line(seed: int) -> Take:
    """Return five hammer shots on a line of geophones on two layers.

    First arrivals are the direct wave and, farther out, the one refracted along the second layer
    (Telford, Geldart and Sheriff, Applied Geophysics, 1990, section 4.3); Rayleigh waves follow,
    slower and stronger.
    """
    rng = np.random.default_rng(seed)
    rate_hz, channels, apart_s, shots = 2000.0, 16, 1.5, 8
    spacing_m = rng.uniform(2.0, 4.0)
    upper, lower = rng.uniform(400, 700), rng.uniform(1400, 2500)
    depth_m = rng.uniform(3.0, 6.0)
    n = round((shots * apart_s + 0.5) * rate_hz)
    samples = rng.normal(0, 3.0, (n, channels))
    names = tuple(f"G{i + 1}" for i in range(channels))
    place_m = np.arange(channels) * float(spacing_m)
    labels = []
    for shot, source in enumerate(np.linspace(-spacing_m, channels * spacing_m, shots)):
        at_s = 0.6 + shot * apart_s
        far_m = np.abs(place_m - source) + 0.5
        cosine = np.sqrt(1 - (upper / lower) ** 2)
        first_s = np.minimum(far_m / upper, far_m / lower + 2 * depth_m * cosine / upper)
        slow_s = far_m / (0.45 * upper) + 0.01
        labels.append(Label(START_NS + round(at_s * NS_PER_S), "impact", label=f"shot {shot + 1}"))
        for c in range(channels):
            strength = 6000 / (1 + far_m[c] / 4)
            _add(samples[:, c], rate_hz, at_s + first_s[c], 60.0, strength)
            _add(samples[:, c], rate_hz, at_s + slow_s[c], 25.0, 2.5 * strength)
            arrival_ns = START_NS + round((at_s + first_s[c]) * NS_PER_S)
            labels.append(Label(arrival_ns, "pick", channel=names[c], author=SIMULATOR))
    stream = Stream(
        "/geophones",
        tuple(
            Channel(name, "ground_velocity", "m/s", "z", 1e-7, (x, 0.0, 0.0))
            for name, x in zip(names, place_m.tolist(), strict=True)
        ),
        rate_hz,
    )
    sensors = tuple(Sensor(m, m, x, 0.0) for m, x in zip(names, place_m.tolist(), strict=True))
    return Take(stream, "i16le", samples, START_NS, labels, Geometry(sensors=sensors))


def _add(trace: NDArray[np.float64], rate_hz: float, at_s: float, hz: float, peak: float) -> None:
    """Add a wavelet that begins at a time: a damped sine that rises within a quarter period."""
    t = np.arange(round(3 / hz * rate_hz) + 1) / rate_hz
    begin = at_s * rate_hz
    first = int(np.ceil(begin))
    t = t + (first - begin) / rate_hz
    rise = np.minimum(t * hz * 4, 1.0)
    trace[first : first + len(t)] += peak * rise * np.sin(2 * np.pi * hz * t) * np.exp(-t * hz)


# --- any recording with steps -------------------------------------------------------------------


def shifted_truth(clean: Clean, rng: Rng, tolerance_ns: int = 120_000_000) -> Planted | None:
    """Label one step 30 to 300 ms early or late, at most 0.45 of a step time from its detection."""
    inner = clean.inner()
    if not inner:
        return None
    number = int(rng.choice(inner))
    step = clean.take.steps()[number]
    off_ns = round(rng.uniform(0.03, 0.3) * rng.choice([-1, 1]) * NS_PER_S)
    time_ns = step.time_ns + off_ns
    late_ns = abs(clean.found_ns[step.time_ns] - time_ns)
    if late_ns > 0.45 * clean.step_ns(number):
        return None
    take = clean.take.copy()
    take.labels.remove(step)
    take.labels.append(replace(step, time_ns=time_ns))
    return Planted(take, time_ns, expected="right" if late_ns <= tolerance_ns else "timing")


def late_recording(clean: Clean, rng: Rng, tolerance_ns: int = 120_000_000) -> Planted | None:
    """Let the whole signal come 30 to 300 ms late, at most 0.45 of a step time."""
    inner = clean.inner()
    if not inner:
        return None
    number = int(rng.choice(inner))
    time_ns = clean.take.steps()[number].time_ns
    take = clean.take.copy()
    n = take.count(rng.uniform(0.03, 0.3))
    late_ns = clean.found_ns[time_ns] - time_ns + round(n / take.rate_hz * NS_PER_S)
    if abs(late_ns) > 0.45 * clean.step_ns(number):
        return None
    take.samples = np.concatenate([take.samples[:n][::-1], take.samples[:-n]])
    return Planted(take, time_ns, expected="right" if abs(late_ns) <= tolerance_ns else "timing")


def doubled_truth(clean: Clean, rng: Rng) -> Planted | None:
    """Label a step twice: one detection cannot answer both."""
    inner = clean.inner()
    if not inner:
        return None
    step = clean.take.steps()[int(rng.choice(inner))]
    later_ns = step.time_ns + round(rng.uniform(0.02, 0.06) * NS_PER_S)
    if abs(clean.found_ns[step.time_ns] - later_ns) > 110_000_000:
        return None
    take = clean.take.copy()
    take.labels.append(replace(step, time_ns=later_ns))
    return Planted(take, later_ns)


def hole(clean: Clean, rng: Rng) -> Planted | None:
    """Leave out the samples about a step."""
    step = _some_step(clean, rng)
    if step is None:
        return None
    time_ns, at, take = step
    before, after = take.count(rng.uniform(0.3, 0.6)), take.count(rng.uniform(0.3, 0.6))
    take.holes.append((at - before, at + after))
    return Planted(take, time_ns)


def _some_step(clean: Clean, rng: Rng) -> tuple[int, int, Take] | None:
    """Return the time of a step, the sample of its detection, and a copy of the take."""
    inner = clean.inner()
    if not inner:
        return None
    time_ns = clean.take.steps()[int(rng.choice(inner))].time_ns
    return time_ns, clean.take.index(clean.found_ns[time_ns]), clean.take.copy()


# --- walks ----------------------------------------------------------------------------------------


def _window(at: int, half: int) -> tuple[slice, NDArray[np.float64]]:
    """Return a span about a sample, and a flat-topped window over it, shape (n, 1)."""
    n = 2 * half + 1
    edge = max(half // 3, 1)
    ramp = np.sin(np.linspace(0, np.pi / 2, edge)) ** 2
    window = np.ones(n)
    window[:edge], window[-edge:] = ramp, ramp[::-1]
    return slice(at - half, at + half + 1), window[:, None]


def soft_step(clean: Clean, rng: Rng, opened: tuple[str, ...], gate: str) -> Planted | None:
    """Let one step be so much softer than the others."""
    inner = clean.inner()
    if not inner:
        return None
    number = int(rng.choice(inner))
    time_ns = clean.take.steps()[number].time_ns
    take = clean.take.copy()
    at = take.index(clean.found_ns[time_ns])
    half = take.count(0.5 * clean.step_ns(number) / NS_PER_S)
    span, window = _window(at, half)
    mean = take.samples[at - 2 * half : at + 2 * half].mean(axis=0)
    gain = float(np.exp(rng.uniform(np.log(0.003), np.log(0.5))))
    part = take.samples[span] - mean
    take.samples[span] = mean + part * (1 - (1 - gain) * window)
    return Planted(take, time_ns, opened=opened, settings=_just_under(clean, number, gate))


def fast_shake(
    clean: Clean, rng: Rng, opened: tuple[str, ...], tight: tuple[str, ...]
) -> Planted | None:
    """Label a step where the sensor lies still but for half a second of shaking at 18 to 30 Hz.

    Along gravity: across it, the length of the acceleration would swing slowly too.
    """
    planted = nobody(clean, rng, tight)
    if planted is None:
        return None
    take = planted.take
    at, half = take.index(planted.time_ns), take.count(0.25)
    t = np.arange(-half, half + 1) / take.rate_hz
    wave = np.hanning(len(t)) * np.cos(2 * np.pi * rng.uniform(18, 30) * t)
    size = rng.uniform(1.5, 4.0) * _upward(take, at)
    take.samples[at - half : at + half + 1, :3] += wave[:, None] * size
    planted.opened = opened
    return planted


def _upward(take: Take, at: int) -> NDArray[np.float64]:
    """Return the direction of gravity about a sample, of length 1."""
    gravity = take.samples[at - 50 : at + 50, :3].mean(axis=0)
    unit: NDArray[np.float64] = gravity / np.linalg.norm(gravity)
    return unit


def lift(clean: Clean, rng: Rng, tight: tuple[str, ...]) -> Planted | None:
    """Label a step where a lift takes a sensor up that lies still: a slow rise without a peak."""
    planted = nobody(clean, rng, tight)
    if planted is None:
        return None
    take = planted.take
    at = take.index(planted.time_ns)
    before, after = min(take.count(0.8), at), take.count(1.4)
    rise = np.linspace(0, 1, before + after) ** 2
    fall = np.cos(np.linspace(0, np.pi / 2, take.count(0.5))) ** 2
    shape = np.concatenate([rise, fall])
    size = rng.uniform(2.0, 5.0) * _upward(take, at)
    take.samples[at - before : at - before + len(shape), :3] += shape[:, None] * size
    return planted


def close_steps(clean: Clean, rng: Rng, opened: tuple[str, ...]) -> Planted | None:
    """Let one step come early: the time between two is cut short, below the refractory time."""
    inner = clean.inner()
    if not inner:
        return None
    number = int(rng.choice(inner))
    take = clean.take.copy()
    steps = take.steps()
    times = sorted(clean.found_ns.values())
    apart_ns = float(np.diff(times).min())
    gap_ns = clean.found_ns[steps[number].time_ns] - clean.found_ns[steps[number - 1].time_ns]
    least_s = 0.97 * apart_ns / NS_PER_S
    cut_ns = gap_ns - rng.uniform(0.65, 0.9) * least_s * NS_PER_S
    if cut_ns <= 0 or least_s < 0.3:
        return None
    n = take.count(cut_ns / NS_PER_S)
    mid = take.index(
        (clean.found_ns[steps[number].time_ns] * 0.5)
        + clean.found_ns[steps[number - 1].time_ns] * 0.5
    )
    first, last = mid - n // 2, mid - n // 2 + n
    blend = min(take.count(0.06), first)
    ramp = np.linspace(0, 1, blend)[:, None]
    joint = take.samples[first - blend : first] * (1 - ramp)
    joint = joint + take.samples[last - blend : last] * ramp
    take.samples = np.concatenate([take.samples[: first - blend], joint, take.samples[last:]])
    earlier = round(n / take.rate_hz * NS_PER_S)
    edge_ns = take.start_ns + round(first / take.rate_hz * NS_PER_S)
    take.labels = [
        replace(x, time_ns=x.time_ns - earlier) if x.time_ns >= edge_ns else x for x in take.labels
    ]
    settings = (f"steps.refractory_s={least_s:.3f}",)
    time_ns = steps[number].time_ns
    return Planted(take, time_ns - earlier, opened=opened, settings=settings, origin_ns=time_ns)


def lonely_step(clean: Clean, rng: Rng, opened: tuple[str, ...]) -> Planted | None:
    """Let one step stand alone, with nobody walking before and after it."""
    step = _some_step(clean, rng)
    if step is None:
        return None
    time_ns, at, take = step
    near = take.count(0.3)
    rest = take.samples[at - near : at + near].mean(axis=0)
    far = take.count(3.0)
    quiet = take.samples[take.count(0.5) : take.count(1.5)]
    noise = quiet - quiet.mean(axis=0)
    segment = take.samples[at - near : at + near].copy()
    begin, end = max(at - far, 0), min(at + far, len(take.samples))
    take.samples[begin:end] = rest + np.resize(noise, (end - begin, take.samples.shape[1]))
    _, window = _window(at, near)
    take.samples[at - near : at + near] += (segment - rest) * window[: len(segment)]
    reach_ns = 3.2 * NS_PER_S
    take.labels = [
        x for x in take.labels if x.time_ns == time_ns or abs(x.time_ns - time_ns) > reach_ns
    ]
    return Planted(take, time_ns, opened=opened)


def held_value(clean: Clean, rng: Rng) -> Planted | None:
    """Let the sensor hang about a step: it repeats one value."""
    step = _some_step(clean, rng)
    if step is None:
        return None
    time_ns, at, take = step
    a, b = at - take.count(rng.uniform(0.35, 0.6)), at + take.count(rng.uniform(0.35, 0.6))
    take.samples[a:b] = take.samples[a]
    return Planted(take, time_ns)


def small_range(clean: Clean, rng: Rng, gate: str) -> Planted | None:
    """Clip the acceleration about a step at a part of its swing, which then stays below a gate.

    The gate's threshold is as high as it may be without missing the clean step.
    """
    inner = clean.inner()
    if not inner:
        return None
    number = int(rng.choice(inner))
    time_ns = clean.take.steps()[number].time_ns
    take = clean.take.copy()
    at = take.index(clean.found_ns[time_ns])
    half = take.count(0.5 * clean.step_ns(number) / NS_PER_S)
    part = take.samples[at - half : at + half + 1, :3]
    mean = part.mean(axis=0)
    limit = np.abs(part - mean).max(axis=0) * rng.uniform(0.1, 0.5)
    take.samples[at - half : at + half + 1, :3] = np.clip(part, mean - limit, mean + limit)
    return Planted(take, time_ns, settings=_just_under(clean, number, gate))


def _just_under(clean: Clean, number: int, gate: str) -> tuple[str, ...]:
    """Return the setting of a gate that just lets in a step and the two on either side of it."""
    steps = clean.take.steps()
    (stage,) = clean.evidence.stages
    rows = stage.between(steps[number - 2].time_ns, steps[number + 2].time_ns)
    column = [g.name for g in stage.spec.gates].index(gate)
    least = float(stage.gate_value[rows[stage.accepted[rows]], column].min())
    return (f"steps.{gate}={0.95 * least:.6f}",)


def nobody(clean: Clean, rng: Rng, tight: tuple[str, ...]) -> Planted | None:
    """Label a step before the first one, where the sensor lies still, in its own noise."""
    take = clean.take.copy()
    first_ns = take.steps()[0].time_ns
    last_s = (first_ns - take.start_ns) / NS_PER_S - 2.0
    if last_s < 2.0:
        return None
    still = take.count(last_s + 1.0)
    ramp = np.ones(still)
    ramp[-take.count(0.5) :] = np.linspace(1, 0, take.count(0.5))
    noise = rng.normal(0, 0.01, (still, take.samples.shape[1]))
    rest = take.samples[:still].mean(axis=0) + noise
    take.samples[:still] += (rest - take.samples[:still]) * ramp[:, None]
    time_ns = take.start_ns + round(rng.uniform(1.0, last_s - 0.5) * NS_PER_S)
    take.labels.append(Label(time_ns, "step"))
    return Planted(take, time_ns, tight=tight)


# --- rooms ----------------------------------------------------------------------------------------

LEAD_S, STEP_S = 0.02, 0.4


def _noise(take: Take, length: int, channels: list[int]) -> NDArray[np.float64]:
    """Return the noise before the first step, as often as needed."""
    first_ns = min(x.time_ns for x in take.labels)
    quiet = take.samples[take.count(0.02) : take.index(first_ns) - take.count(0.05), channels]
    again = -(-length // len(quiet))
    both = np.concatenate([quiet, quiet[::-1]])
    return np.tile(both, (again, 1))[:length]


def weaken(take: Take, time_ns: int, channels: list[int], gain: float) -> None:
    """Leave a part of what channels felt after a moment, in their noise."""
    a, n = take.index(time_ns) - take.count(LEAD_S), take.count(STEP_S)
    part = take.samples[a : a + n, channels]
    take.samples[a : a + n, channels] = (1 - gain) * _noise(take, n, channels)[: len(part)] + (
        gain * part
    )


def _step_in_room(clean: Clean, rng: Rng) -> tuple[Take, int, list[int]] | None:
    """Return a copy of the take, the time of a step, and all channels in a random order."""
    inner = clean.inner()
    if not inner:
        return None
    take = clean.take.copy()
    time_ns = take.steps()[int(rng.choice(inner))].time_ns
    return take, time_ns, rng.permutation(take.samples.shape[1]).tolist()


def soft_footfall(clean: Clean, rng: Rng) -> Planted | None:
    """Let a step be so soft that it stays below the thresholds of the picks on all channels."""
    step = _step_in_room(clean, rng)
    if step is None:
        return None
    take, time_ns, channels = step
    wanted = float(np.exp(rng.uniform(np.log(2.0), np.log(5.0))))
    for channel in channels:
        gain = _kept(clean, channel, time_ns, 0.05, wanted * float(np.exp(rng.normal(0, 0.1))))
        if gain is None:
            return None
        weaken(take, time_ns, [channel], gain)
    return Planted(take, time_ns, opened=("picks.ratio=2",), tight=("steps.min_channels=1",))


def _kept(clean: Clean, channel: int, time_ns: int, reach_s: float, wanted: float) -> float | None:
    """Return what to leave of an arrival so that it comes to a wanted ratio; None if not picked.

    By the ratio that the first stage picked it with, which is one of powers. Drawn blindly, hardly
    any would come between the floor and the threshold.
    """
    part = next(part for part in clean.evidence.stages if part.spec.trace)
    reach_ns = round(reach_s * NS_PER_S)
    rows = part.between(time_ns - reach_ns, time_ns + reach_ns)
    rows = rows[(part.candidates.channel[rows] == channel) & part.accepted[rows]]
    return float(np.sqrt(wanted / part.candidates.value[rows[0], 0])) if len(rows) else None


def few_channels(clean: Clean, rng: Rng) -> Planted | None:
    """Let all but two or three channels feel nothing of a step."""
    step = _step_in_room(clean, rng)
    if step is None:
        return None
    take, time_ns, channels = step
    left = int(rng.integers(2, 4))
    weaken(take, time_ns, channels[left:], 0.0)
    return Planted(take, time_ns, opened=(f"steps.min_channels={left}",))


def dead_channels(clean: Clean, rng: Rng) -> Planted | None:
    """Let so many channels stand still about a step that too few are left."""
    step = _step_in_room(clean, rng)
    if step is None:
        return None
    take, time_ns, channels = step
    a, b = take.index(time_ns) - take.count(0.15), take.index(time_ns) + take.count(0.35)
    take.samples[a:b, channels[3:]] = 0
    return Planted(take, time_ns, opened=("steps.min_channels=3",))


def _overdriven(take: Take, at: int, channel: int, rng: Rng) -> None:
    """Let a hum of many times the range drive an amplifier from rail to rail."""
    a, b = at - take.count(0.45), at + take.count(0.3)
    t = np.arange(b - a) / take.rate_hz
    hum = np.sin(2 * np.pi * rng.uniform(40, 60) * t + rng.uniform(0, 2 * np.pi)) * 8 * 32767
    ramp = np.minimum(t / 0.1, 1.0)
    take.samples[a:b, channel] = np.clip(take.samples[a:b, channel] + ramp * hum, -32768, 32767)


def overdriven_channels(clean: Clean, rng: Rng) -> Planted | None:
    """Let so many channels clip about a step that too few are left."""
    step = _step_in_room(clean, rng)
    if step is None:
        return None
    take, time_ns, channels = step
    for channel in channels[3:]:
        _overdriven(take, take.index(time_ns), channel, rng)
    return Planted(take, time_ns)


def slow_heave(clean: Clean, rng: Rng) -> Planted | None:
    """Put a slow movement, below the pickers' band, in the place of a step."""
    step = _step_in_room(clean, rng)
    if step is None:
        return None
    take, time_ns, channels = step
    _heave(take, time_ns, channels, rng)
    return Planted(take, time_ns, opened=("picks.low_hz=0", "picks.high_hz=0"))


def _heave(take: Take, time_ns: int, channels: list[int], rng: Rng) -> None:
    a, n = take.index(time_ns), take.count(rng.uniform(0.2, 0.35))
    size = np.abs(take.samples[a : a + n, channels]).max(axis=0) * rng.uniform(1, 3)
    weaken(take, time_ns, channels, 0.0)
    take.samples[a : a + n, channels] += np.sin(np.pi * np.arange(n) / n)[:, None] ** 2 * size


def second_footfall(clean: Clean, rng: Rng) -> Planted | None:
    """Let a step follow 120 to 220 ms after another."""
    step = _step_in_room(clean, rng)
    if step is None:
        return None
    take, time_ns, _ = step
    later_s = rng.uniform(0.12, 0.22)
    a, n, shift = take.index(time_ns), take.count(0.1), take.count(later_s)
    take.samples[a + shift : a + shift + n] += 3 * take.samples[a : a + n].copy()
    later_ns = time_ns + round(shift / take.rate_hz * NS_PER_S)
    take.labels.append(Label(later_ns, "step"))
    opened = ("picks.refractory_s=0", "steps.refractory_s=0")
    return Planted(take, later_ns, opened=opened)


def no_footfall(clean: Clean, rng: Rng) -> Planted | None:
    """Label a step in noise, a second after the last one."""
    take = clean.take.copy()
    more = take.count(2.5)
    channels = list(range(take.samples.shape[1]))
    take.samples = np.concatenate([take.samples, _noise(take, more, channels)])
    end_ns = take.start_ns + round((len(take.samples) - more) / take.rate_hz * NS_PER_S)
    time_ns = end_ns + round(rng.uniform(0.7, 2.0) * NS_PER_S)
    take.labels.append(Label(time_ns, "step"))
    return Planted(take, time_ns, tight=("picks.ratio=2",))


# --- picks ----------------------------------------------------------------------------------------


def _arrival(clean: Clean, rng: Rng) -> tuple[Take, Label, int]:
    """Return a copy of the take, one of its arrivals that are no edge, and its channel's number."""
    take = clean.take.copy()
    channel = int(rng.integers(len(take.stream.channels)))
    arrivals = take.arrivals(take.stream.channels[channel].name)
    return take, arrivals[int(rng.integers(1, len(arrivals) - 1))], channel


def _moved(take: Take, channel: int, at: int, length: int, n: int) -> None:
    """Let a stretch of a channel come some samples later."""
    a = at - take.count(LEAD_S)
    part = take.samples[a - n : a + length - n, channel].copy()
    take.samples[a : a + length, channel] = part


def late_arrival(clean: Clean, rng: Rng) -> Planted:
    """Let one arrival come 4 to 30 ms later on one channel."""
    take, arrival, channel = _arrival(clean, rng)
    n = take.count(rng.uniform(0.004, 0.03))
    _moved(take, channel, take.index(arrival.time_ns), take.count(0.3), n)
    return Planted(take, arrival.time_ns, arrival.channel)


def knock_before(clean: Clean, rng: Rng) -> Planted:
    """Add a short knock 4 to 30 ms before an arrival on its channel."""
    take, arrival, channel = _arrival(clean, rng)
    at = take.index(arrival.time_ns) - take.count(rng.uniform(0.004, 0.03))
    _knock(take, channel, at, rng)
    return Planted(take, arrival.time_ns, arrival.channel, state="early")


def _knock(take: Take, channel: int, at: int, rng: Rng) -> None:
    n = take.count(0.02)
    t = np.arange(n) / take.rate_hz
    loud = np.abs(take.samples[:, channel]).max() * rng.uniform(0.1, 0.6)
    take.samples[at : at + n, channel] += loud * np.sin(2 * np.pi * 150 * t) * np.exp(-t * 150)


def knock_elsewhere(clean: Clean, rng: Rng) -> Planted | None:
    """Add a knock to one channel 0.27 to 0.35 s after an arrival, where none is."""
    take, arrival, channel = _arrival(clean, rng)
    at = take.index(arrival.time_ns) + take.count(rng.uniform(0.27, 0.35))
    time_ns = take.start_ns + round(at / take.rate_hz * NS_PER_S)
    if any(abs(x.time_ns - time_ns) < 100_000_000 for x in take.labels):
        return None
    _knock(take, channel, at, rng)
    return Planted(take, time_ns, arrival.channel, expected="false")


def late_clock(clean: Clean, rng: Rng) -> Planted:
    """Let the clock of one channel be 4 to 20 ms late, all the time."""
    take, arrival, channel = _arrival(clean, rng)
    n = take.count(rng.uniform(0.004, 0.02))
    take.samples[n:, channel] = take.samples[:-n, channel].copy()
    return Planted(take, arrival.time_ns, arrival.channel)


def by_hand(clean: Clean, rng: Rng) -> Planted:
    """Let somebody have picked one channel 4 to 20 ms late by hand, on the same trace."""
    take, arrival, _ = _arrival(clean, rng)
    late_ns = round(rng.uniform(0.004, 0.02) * NS_PER_S)
    take.labels = [
        replace(x, author="somebody", time_ns=x.time_ns + late_ns * (x.channel == arrival.channel))
        if x.kind == "pick"
        else x
        for x in take.labels
    ]
    return Planted(take, arrival.time_ns + late_ns, arrival.channel)


def weak_arrival(clean: Clean, rng: Rng) -> Planted | None:
    """Let one arrival be weak on one channel."""
    take, arrival, channel = _arrival(clean, rng)
    wanted = float(np.exp(rng.uniform(np.log(1.5), np.log(7.5))))
    gain = _kept(clean, channel, arrival.time_ns, 0.002, wanted)
    if gain is None:
        return None
    weaken(take, arrival.time_ns, [channel], gain)
    return Planted(take, arrival.time_ns, arrival.channel, opened=("picks.ratio=2",))


def no_arrival(clean: Clean, rng: Rng) -> Planted:
    """Let one channel feel nothing of a step or shot."""
    take, arrival, channel = _arrival(clean, rng)
    weaken(take, arrival.time_ns, [channel], 0.0)
    return Planted(take, arrival.time_ns, arrival.channel, tight=("picks.ratio=2",))


def held_off(clean: Clean, rng: Rng) -> Planted:
    """Add a knock 80 to 200 ms before an arrival, which the refractory time holds off."""
    take, arrival, channel = _arrival(clean, rng)
    weaken(take, arrival.time_ns - round(0.22 * NS_PER_S), [channel], 0.0)
    at = take.index(arrival.time_ns) - take.count(rng.uniform(0.08, 0.2))
    take.samples[take.index(arrival.time_ns) - take.count(0.01) :, channel] = clean.take.samples[
        take.index(arrival.time_ns) - take.count(0.01) :, channel
    ]
    _knock(take, channel, at, rng)
    return Planted(take, arrival.time_ns, arrival.channel, opened=("picks.refractory_s=0",))


def second_shot(clean: Clean, rng: Rng) -> Planted | None:
    """Let another shot follow 0.25 to 0.45 s after one, at the same place and twice as strong."""
    take, arrival, _ = _arrival(clean, rng)
    shots = sorted(x for x in take.labels if x.kind == "impact")
    shot = max(x for x in shots if x.time_ns <= arrival.time_ns)
    n, length = take.count(rng.uniform(0.25, 0.45)), take.count(0.3)
    a = take.index(shot.time_ns)
    take.samples[a + n : a + n + length] += 2 * take.samples[a : a + length].copy()
    later_ns = round(n / take.rate_hz * NS_PER_S)
    until_ns = min((x.time_ns for x in shots if x.time_ns > shot.time_ns), default=2**62)
    shot_labels = [x for x in take.labels if shot.time_ns <= x.time_ns < until_ns]
    take.labels += [replace(x, time_ns=x.time_ns + later_ns) for x in shot_labels]
    opened = ("picks.refractory_s=0",)
    return Planted(take, arrival.time_ns + later_ns, arrival.channel, opened=opened, tight=None)


def swelling_channel(clean: Clean, rng: Rng) -> Planted | None:
    """Let a channel swell over a quarter of a second in the place of an arrival, as a hum does.

    Its power more than doubles in every 10 ms, ever faster, so that it is above the floor of the
    picks, has no maximum of its own before its end, and is below their threshold there.
    """
    take, arrival, channel = _arrival(clean, rng)
    at, n = take.index(arrival.time_ns), take.count(0.25)
    end = at + take.count(rng.uniform(0.06, 0.09))
    t = (np.arange(n) - n) / take.rate_hz
    weaken(take, arrival.time_ns, [channel], 0.0)
    growth = rng.uniform(58, 64) * (t + t**2)
    after = np.arange(take.count(0.25)) / take.rate_hz
    size = np.exp(np.concatenate([growth, -after * 30]))
    wave = np.cos(2 * np.pi * rng.uniform(1600, 1800) * np.arange(len(size)) / take.rate_hz)
    loud = 20_000  # of 32 767, far above the noise for long enough
    take.samples[end - n : end - n + len(size), channel] += loud * size * wave
    return Planted(take, arrival.time_ns, arrival.channel, tight=("picks.ratio=2",), state="unseen")


def dead_channel(clean: Clean, rng: Rng) -> Planted:
    """Let one channel stand still about an arrival."""
    take, arrival, channel = _arrival(clean, rng)
    at = take.index(arrival.time_ns)
    take.samples[at - take.count(0.3) : at + take.count(0.4), channel] = 0
    return Planted(take, arrival.time_ns, arrival.channel)


def overdriven_channel(clean: Clean, rng: Rng) -> Planted:
    """Let one channel clip about an arrival."""
    take, arrival, channel = _arrival(clean, rng)
    _overdriven(take, take.index(arrival.time_ns), channel, rng)
    return Planted(take, arrival.time_ns, arrival.channel)


def heaved_channel(clean: Clean, rng: Rng) -> Planted:
    """Put a slow movement in the place of an arrival on one channel."""
    take, arrival, channel = _arrival(clean, rng)
    _heave(take, arrival.time_ns, [channel], rng)
    opened = ("picks.low_hz=0", "picks.high_hz=0")
    return Planted(take, arrival.time_ns, arrival.channel, opened=opened, state="missed")


def hole_at_arrival(clean: Clean, rng: Rng) -> Planted:
    """Leave out the samples about an arrival, on all channels."""
    take, arrival, _ = _arrival(clean, rng)
    at = take.index(arrival.time_ns)
    take.holes.append((at - take.count(0.25), at + take.count(0.35)))
    return Planted(take, arrival.time_ns, arrival.channel)


# --- places ---------------------------------------------------------------------------------------


def _sensor(clean: Clean, rng: Rng) -> tuple[Take, int, str]:
    take = clean.take.copy()
    channel = int(rng.integers(len(take.stream.channels)))
    return take, channel, take.stream.channels[channel].name


def _with_sensors(take: Take, change: Callable[[list[Sensor]], None]) -> None:
    assert take.geometry is not None
    sensors = list(take.geometry.sensors)
    change(sensors)
    take.geometry = replace(take.geometry, sensors=tuple(sensors))


def displaced_sensor(clean: Clean, rng: Rng) -> Planted:
    """Write a place 0.8 to 2 m off into the geometry."""
    take, channel, name = _sensor(clean, rng)
    angle, far = rng.uniform(0, 2 * np.pi), rng.uniform(0.8, 2.0)

    def move(sensors: list[Sensor]) -> None:
        s = sensors[channel]
        x, y = s.x + far * np.cos(angle), s.y + far * np.sin(angle)
        sensors[channel] = replace(s, x=float(x), y=float(y))

    _with_sensors(take, move)
    return Planted(take, take.steps()[len(take.steps()) // 2].time_ns, name)


def swapped_sensors(clean: Clean, rng: Rng) -> Planted:
    """Swap two sensors in the geometry."""
    take, channel, name = _sensor(clean, rng)
    other = (channel + int(rng.integers(1, len(take.stream.channels)))) % len(take.stream.channels)

    def swap(sensors: list[Sensor]) -> None:
        a, b = sensors[channel], sensors[other]
        sensors[channel] = replace(a, x=b.x, y=b.y)
        sensors[other] = replace(b, x=a.x, y=a.y)

    _with_sensors(take, swap)
    return Planted(take, take.steps()[len(take.steps()) // 2].time_ns, name)


def sensor_clock(clean: Clean, rng: Rng) -> Planted:
    """Let the clock of one sensor be 3 to 12 ms late."""
    take, channel, name = _sensor(clean, rng)
    n = take.count(rng.uniform(0.003, 0.012))
    take.samples[n:, channel] = take.samples[:-n, channel].copy()
    return Planted(take, take.steps()[len(take.steps()) // 2].time_ns, name)


def late_at_place(clean: Clean, rng: Rng) -> Planted:
    """Let one arrival of a step come 5 to 20 ms late."""
    take, channel, name = _sensor(clean, rng)
    step = take.steps()[int(rng.integers(1, len(take.steps()) - 1))]
    n = take.count(rng.uniform(0.005, 0.02))
    _moved(take, channel, take.index(step.time_ns), take.count(0.35), n)
    return Planted(take, step.time_ns, name)


def early_at_place(clean: Clean, rng: Rng) -> Planted:
    """Add a knock 5 to 12 ms before one arrival of a step."""
    take, channel, name = _sensor(clean, rng)
    number = int(rng.integers(1, len(take.steps()) - 1))
    at = take.index(take.arrivals(name)[number].time_ns) - take.count(rng.uniform(0.005, 0.012))
    _knock(take, channel, at, rng)
    return Planted(take, take.steps()[number].time_ns, name)


def overdriven_at_place(clean: Clean, rng: Rng) -> Planted:
    """Let so many channels clip in a step that only two are left."""
    take = clean.take.copy()
    step = take.steps()[int(rng.integers(1, len(take.steps()) - 1))]
    for channel in rng.permutation(take.samples.shape[1]).tolist()[2:]:
        _overdriven(take, take.index(step.time_ns), channel, rng)
    return Planted(take, step.time_ns, settings=("steps.min_channels=2",))


def dead_at_place(clean: Clean, rng: Rng) -> Planted:
    """Let so many channels stand still in a step that only two are left."""
    return _silenced(clean, rng, dead=True)


def weak_at_place(clean: Clean, rng: Rng) -> Planted:
    """Let so many channels feel little of a step that only two are left."""
    return _silenced(clean, rng, dead=False)


def _silenced(clean: Clean, rng: Rng, *, dead: bool) -> Planted:
    take = clean.take.copy()
    step = take.steps()[int(rng.integers(1, len(take.steps()) - 1))]
    channels = rng.permutation(take.samples.shape[1]).tolist()[2:]
    if dead:
        a, b = take.index(step.time_ns) - take.count(0.15), take.index(step.time_ns)
        take.samples[a : b + take.count(0.35), channels] = 0
    else:
        weaken(take, step.time_ns, channels, 0.0)
    return Planted(take, step.time_ns, settings=("steps.min_channels=2",))


def scattered_arrivals(clean: Clean, rng: Rng) -> Planted:
    """Let every arrival of a step come 0 to 8 ms late, each by another time."""
    take = clean.take.copy()
    step = take.steps()[int(rng.integers(1, len(take.steps()) - 1))]
    for channel in range(take.samples.shape[1]):
        n = take.count(rng.uniform(0, 0.008))
        if n:
            _moved(take, channel, take.index(step.time_ns), take.count(0.35), n)
    return Planted(take, step.time_ns)


def wrong_velocity(clean: Clean, rng: Rng) -> Planted:
    """Let the localizer reckon with waves 1.5 to 3 times as fast or slow as they are."""
    take = clean.take.copy()
    assert take.geometry is not None
    assert take.geometry.medium.velocity_mps
    step = take.steps()[int(rng.integers(1, len(take.steps()) - 1))]
    factor = rng.uniform(1.5, 3.0) ** rng.choice([-1, 1])
    velocity_mps = take.geometry.medium.velocity_mps * factor
    settings = (f"hyperbolic.velocity_mps={velocity_mps:.1f}",)
    return Planted(take, step.time_ns, settings=settings)


def narrow_gate(clean: Clean, rng: Rng) -> Planted | None:
    """Set the gate of the places so narrow that it rejects the one that fits its arrivals as usual.

    Of the one that fits least an arrival may be off too, which then is a second cause.
    """
    located = next(part for part in clean.evidence.stages if part.spec.stage == "power-law")
    gate = [g.name for g in located.spec.gates].index("residual")
    value = located.gate_value[:, gate]
    if not len(value) or not located.accepted.all():
        return None
    row = int(np.argsort(value)[len(value) // 2])
    limit = float(value[row]) * rng.uniform(0.9, 0.99)
    settings = (f"power-law.max_residual_s={limit:.8f}",)
    return Planted(clean.take.copy(), int(located.candidates.time_ns[row]), settings=settings)
