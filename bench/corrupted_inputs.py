"""Real recordings, each with one thing wrong: told or not. The table of faults.md.

    python bench/corrupted_inputs.py --data FOLDER [--rooms 300] [--each]

The folder holds ``mobgap``, ``broad``, ``indoor-location-20``, ``llio-pyshoe``, ``xio-gait``,
``back-steps`` and ``robot-localization`` as published; what is absent is left out. Of each sample's
values one thing is made wrong, then the recording is read as ``groundtrace info`` reads it: told is
what gives a fault of the right kind. ``named`` is how often the change to the map undoes what was
done. BROAD, mobgap and the simulated rooms of seeds under 1000 have chosen constants; of all else
llio-pyshoe alone has, how steep a gyroscope's corners are near its full scale. Fails where an
untouched recording is said to contradict itself.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
import tempfile
from collections import Counter, defaultdict
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from groundtrace.detectors.fault_scan import FaultScan, MonitoredRecording
from groundtrace.inertial.worn_sensor_faults import ImuWatch, contradiction
from groundtrace.pipeline.source import Source
from groundtrace.simulate.gait import WalkOptions
from groundtrace.simulate.room import simulate_room
from groundtrace.simulate.room_plan import RoomOptions
from groundtrace.simulate.walk import simulate_walk
from groundtrace_codecs.events import Gap
from groundtrace_codecs.importers.run import import_recording
from groundtrace_codecs.importers.units import UnitWatch
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S, SignalBlock
from groundtrace_recordings import bundled, map_path

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from groundtrace_codecs.signals import Stream

TURNING, FORCE, FIELD = "angular_velocity", "acceleration", "magnetic_field"
#: What chose constants.
CHOSEN = ("mobgap", "broad")
#: Kinds of findings about worn sensors that no untouched recording may have.
CONTRADICTIONS = frozenset({"axes", "unit", "zero"})
#: Of back-steps, one walk of each person is made wrong; all are read untouched.
SHORT = "back-steps"


@dataclass
class Tape:
    """A recording in memory, its samples in SI units."""

    streams: tuple[Stream, ...]
    stamped: list[tuple[int, SignalBlock]]

    def blocks(self, *_: object) -> Iterator[tuple[int, SignalBlock]]:
        """Yield all blocks."""
        yield from self.stamped

    def has(self, quantity: str) -> bool:
        """Return whether some stream carries a quantity."""
        return any(s.columns_of({quantity}) for s in self.streams)

    def changed(self, change: Callable[[SignalBlock], SignalBlock | None]) -> Tape:
        """Return the tape with every block changed, or left out."""
        blocks = [(at, change(block)) for at, block in self.stamped]
        return Tape(self.streams, [(at, block) for at, block in blocks if block is not None])

    @property
    def span_ns(self) -> tuple[int, int]:
        """First and last time."""
        return (
            min(block.start_ns for _, block in self.stamped),
            max(block.last_ns for _, block in self.stamped),
        )


@dataclass
class Told:
    """What ``info`` says of a tape."""

    kinds: set[tuple[str, str]]
    units: list[str]
    gaps: Counter[str]
    matrices: list[tuple[str, np.ndarray]]


def tape(path: Path) -> Tape:
    """Read a recording."""
    with Recording.open(path) as opened:
        stamped = list(opened.blocks())
        return in_si(opened.streams, stamped)


def in_si(streams: tuple[Stream, ...], stamped: list[tuple[int, SignalBlock]]) -> Tape:
    """Return blocks with scales applied."""
    plain = {
        s.topic: replace(s, channels=tuple(replace(c, scale=1.0) for c in s.channels))
        for s in streams
    }
    return Tape(
        tuple(plain.values()),
        [(at, replace(b, stream=plain[b.topic], samples=b.values)) for at, b in stamped],
    )


def told(of: Tape, *, channels: bool = True) -> Told:
    """Read a tape as ``info`` does; without ``channels``, single ones are not looked at."""
    health = {s.topic: FaultScan(s) for s in of.streams if channels}
    units = {s.topic: UnitWatch(s) for s in of.streams}
    source = Source(MonitoredRecording(of, health) if channels else of)
    worn = ImuWatch(source.streams, limits=False)
    gaps: Counter[str] = Counter()
    for item in source:
        if channels:
            health[item.topic].update(item)
        worn.update(item)
        if isinstance(item, Gap):
            gaps[item.reason] += 1
        else:
            units[item.topic].update(item)
    worn.flush()
    remarks = [line for watch in units.values() for line in watch.remarks()]
    kinds = set()
    for watch in health.values():
        quantity = {c.name: c.quantity for c in watch.stream.channels}
        kinds |= {(f.kind, quantity.get(f.channel, "")) for f in watch.findings()}
    kinds |= {(f.kind, f.channel) for f in worn.findings(remarks)}
    contradictions = [contradiction(s.judges()) for s in worn.sensors]
    matrices = [(c.fits.quantity, c.fits.matrix) for c in contradictions if c is not None]
    return Told(kinds, remarks, gaps, matrices)


@dataclass(frozen=True)
class Case:
    """One thing that is made wrong."""

    group: str
    name: str
    needs: str
    change: Callable[[Tape, np.random.Generator], Tape]
    kinds: frozenset[str]
    #: The map that undoes it: whose, and the matrix.
    undo: tuple[str, np.ndarray] | None = None


def turned(quantities: tuple[str, ...], matrix: np.ndarray) -> Callable[[Tape, object], Tape]:
    """Return a change of axes or scales of vectors."""

    def change(block: SignalBlock) -> SignalBlock:
        samples = block.samples.copy()
        for quantity in quantities:
            at = {block.stream.channels[c].axis: c for c in block.stream.columns_of({quantity})}
            if at.keys() >= set("xyz"):
                columns = [at[axis] for axis in "xyz"]
                samples[:, columns] = samples[:, columns] @ matrix.T
        return replace(block, samples=samples)

    return lambda of, _: of.changed(change)


def clipped(quantity: str, part: float, rough: float) -> Callable[[Tape, object], Tape]:
    """Return a limit at a part of the largest value, a calibration behind it."""

    def make(of: Tape, random: np.random.Generator) -> Tape:
        limit = part * max(
            float(np.nanmax(np.abs(b.samples[:, b.stream.columns_of({quantity})])))
            for _, b in of.stamped
            if b.stream.columns_of({quantity})
        )

        def change(block: SignalBlock) -> SignalBlock:
            samples = block.samples.copy()
            for c in block.stream.columns_of({quantity}):
                scale = 1 + 0.01 * (c % 3 - 1)
                samples[:, c] = scale * np.clip(samples[:, c], -limit, limit)
                samples[:, c] += random.normal(0, rough * limit, len(samples)) if rough else 0
            return replace(block, samples=samples)

        return of.changed(change)

    return make


def held(quantity: str, from_part: float, value: float | None) -> Callable[[Tape, object], Tape]:
    """Return the x axis at one value from a part of the recording on."""

    def make(of: Tape, _: object) -> Tape:
        start_ns, end_ns = of.span_ns
        from_ns = start_ns + round(from_part * (end_ns - start_ns))
        first_values: dict[int, float] = {}

        def change(block: SignalBlock) -> SignalBlock:
            samples = block.samples.copy()
            late = block.sample_times() >= from_ns
            for c in block.stream.columns_of({quantity}):
                if block.stream.channels[c].axis == "x" and late.any():
                    first = float(samples[np.argmax(late), c])
                    samples[late, c] = first_values.setdefault(c, first) if value is None else value
            return replace(block, samples=samples)

        return of.changed(change)

    return make


def added(quantity: str, value: float) -> Callable[[Tape, object], Tape]:
    """Return an offset of the x axis."""

    def change(block: SignalBlock) -> SignalBlock:
        samples = block.samples.copy()
        for c in block.stream.columns_of({quantity}):
            samples[:, c] += value if block.stream.channels[c].axis == "x" else 0.0
        return replace(block, samples=samples)

    return lambda of, _: of.changed(change)


def lost(share: float, length_s: float) -> Callable[[Tape, object], Tape]:
    """Return packets left out at random."""

    def make(of: Tape, random: np.random.Generator) -> Tape:
        stamped = []
        for at, block in of.stamped:
            size = max(1, round(length_s * block.stream.rate_hz))
            stamped += [
                (at, block.slice(first, min(first + size, len(block))))
                for first in range(0, len(block), size)
                if random.random() >= share
            ]
        return Tape(of.streams, stamped)

    return make


def stepped(by_s: float) -> Callable[[Tape, object], Tape]:
    """Return a clock that jumps in the middle."""

    def make(of: Tape, _: object) -> Tape:
        start_ns, end_ns = of.span_ns
        middle_ns, by_ns = (start_ns + end_ns) // 2, round(by_s * NS_PER_S)

        def moved(block: SignalBlock) -> SignalBlock:
            if block.times_ns is not None:
                return replace(block, times_ns=block.times_ns + by_ns)
            return replace(block, anchor_ns=block.anchor_ns + by_ns)

        stamped = []
        for at, block in of.stamped:
            cut = block.index_of(middle_ns)
            before, after = block.slice(0, cut), block.slice(cut, len(block))
            stamped += [(at, before)] if len(before) else []
            stamped += [(at, moved(after))] if len(after) else []
        return Tape(of.streams, stamped)

    return make


def cases() -> Iterator[Case]:
    """Yield all that is made wrong."""
    eye = np.eye(3)
    swaps = {"x and y": [1, 0, 2], "y and z": [0, 2, 1], "x and z": [2, 1, 0]}
    axes, unit = frozenset({"axes"}), frozenset({"unit"})
    words = {TURNING: "gyroscope", FORCE: "acceleration", FIELD: "field"}
    for quantity, word in words.items():
        changes = [(f"{a} exchanged", eye[order]) for a, order in swaps.items()]
        changes.append(("x, y, z in turn", eye[[1, 2, 0]]))
        changes += [(f"sign of {'xyz'[k]}", np.diag(1.0 - 2 * eye[k])) for k in range(3)]
        changes.append(("all three signs", -eye))
        for name, matrix in changes:
            change = turned((quantity,), matrix)
            undo = (quantity, matrix.T)
            yield Case(f"axes of {word}", f"{word}: {name}", quantity, change, axes, undo)
    for name, matrix in (
        ("x mirrored", np.diag([-1.0, 1, 1])),
        ("x and y exchanged", eye[[1, 0, 2]]),
    ):
        yield Case(
            "left-handed frame",
            f"all three vectors: {name}",
            TURNING,
            turned((TURNING, FORCE, FIELD), matrix),
            axes,
            (TURNING, -eye),
        )
    for quantity, factor, name in (
        (TURNING, 180 / math.pi, "gyroscope: deg/s called rad/s"),
        (TURNING, math.pi / 180, "gyroscope: rad/s called deg/s"),
        (FORCE, 1 / 9.80665, "acceleration: g called m/s2"),
        (FORCE, 9.80665, "acceleration: m/s2 called g"),
    ):
        yield Case("units", name, quantity, turned((quantity,), factor * eye), unit)
    zero = frozenset({"zero"})
    yield Case("zeros", "field: zero", FIELD, turned((FIELD,), 0 * eye), zero)
    yield Case("zeros", "gyroscope: zero", TURNING, turned((TURNING,), 0 * eye), zero)
    for quantity, word in ((TURNING, "gyroscope"), (FORCE, "acceleration")):
        for part in (0.5, 0.75):
            for rough, how in ((0.0, ""), (5e-4, ", noise of 0.05 %")):
                name = f"{word}: limit at {part:g} of the largest value{how}"
                change = clipped(quantity, part, rough)
                yield Case("limits", name, quantity, change, frozenset({"clipped"}))
    dead = frozenset({"constant", "late"})
    yield Case("dead", "gyroscope: x is 0", TURNING, held(TURNING, 0, 0.0), dead)
    yield Case(
        "dead", "acceleration: x stands still from the middle", FORCE, held(FORCE, 0.5, None), dead
    )
    gap = frozenset({"gap"})
    yield Case("time", "packets of 50 ms lost, 5 %", FORCE, lost(0.05, 0.05), gap)
    yield Case("time", "packets of 0.5 s lost, 5 %", FORCE, lost(0.05, 0.5), gap)
    yield Case("time", "clock steps on by 2 s", FORCE, stepped(2.0), gap)
    yield Case("time", "clock steps back by 2 s", FORCE, stepped(-2.0), gap)
    yield Case(
        "not looked for", "gyroscope: x off by 0.1 rad/s", TURNING, added(TURNING, 0.1), axes
    )
    yield Case("not looked for", "acceleration: x off by 0.5 m/s2", FORCE, added(FORCE, 0.5), axes)


@dataclass(frozen=True)
class Spec:
    """A recording that is there: its set, its name, its file and the map to read it by."""

    group: str
    name: str
    path: Path | None
    columns: str = ""
    seed: int = 0

    def read(self) -> Tape:
        """Return its tape."""
        if self.path is None:
            walk = simulate_walk(WalkOptions(path="epfl", seed=self.seed))
            streams = tuple(stream for stream, _, _ in walk.sources)
            stamped = [(b.start_ns, b) for _, _, blocks in walk.sources for b in blocks]
            return in_si(streams, sorted(stamped, key=lambda x: x[0]))
        if self.path.suffix == ".mcap":
            return tape(self.path)
        with tempfile.TemporaryDirectory() as folder:
            file, columns = Path(folder) / "rec.mcap", Path(folder) / "map.toml"
            if self.group == SHORT:  # the field's unit is unknown
                text = (self.path.parent / "map.toml").read_text()
                columns.write_text(text.replace("a.u.", "count"))
            elif self.columns:
                columns = map_path(self.columns)
            import_recording([self.path], file, map_path=columns if columns.exists() else None)
            return tape(file)


def recordings(folder: Path) -> Iterator[Spec]:
    """Yield the recordings that are there."""
    for path in sorted(folder.glob("mobgap/*/*/data.mat")):
        yield Spec("mobgap", path.parts[-3], path, "mobgap-test11.toml")
    for kind in ("hdf5", "mat"):
        for path in sorted(folder.glob(f"broad/*.{kind}")):
            yield Spec("broad", path.stem[:2], path, f"broad-{kind}.toml")
    for path in sorted(folder.glob("indoor-location-20/*/*/path_data_files/*.txt")):
        yield Spec("indoor-location-20", path.stem, path)
    for path in sorted(folder.glob("llio-pyshoe/*.mat")):
        yield Spec("llio-pyshoe", path.stem, path, "llio-pyshoe.toml")
    for path in sorted(folder.glob("xio-gait/*.csv")):
        yield Spec("xio-gait", path.stem, path, "xio-gait.toml")
    for path in sorted(folder.glob("back-steps/*/signal.csv")):
        yield Spec(SHORT, path.parent.name, path)
    for path in sorted(folder.glob("robot-localization/*.mcap")):
        yield Spec("robot-localization", path.stem, path)
    yield Spec("simulated", "waist-walk", bundled()["waist-walk.mcap"])
    for seed in (1, 2):
        yield Spec("simulated", f"epfl {seed}", None, seed=seed)


def is_told(case: Case, reported: Told) -> bool:
    """Return whether what was made wrong was told as what it is."""
    if case.group == "time":
        return sum(reported.gaps.values()) > 0
    if any(kind in case.kinds and of == case.needs for kind, of in reported.kinds):
        return True
    if "unit" in case.kinds and any(f": {case.needs} in " in line for line in reported.units):
        return True
    return "axes" in case.kinds and any(kind == "axes" for kind, _ in reported.kinds)


def is_named(case: Case, reported: Told) -> bool:
    """Return whether the map that undoes it was named; a sign of a whole vector is not told."""
    if case.undo is None:
        return False
    quantity, matrix = case.undo
    return any(q == quantity and (np.abs(m - matrix) < 0.5).all() for q, m in reported.matrices)


@dataclass
class Judged:
    """What came of one recording: untouched, and of each case whether it was told and named."""

    spec: Spec
    contradicted: list[str]
    clipped: list[str]
    cases: dict[str, tuple[bool, bool, list[tuple[str, str]]]]


def judged(spec: Spec) -> Judged:
    """Read a recording as it is, and with each thing made wrong."""
    of = spec.read()
    untouched = told(of)
    bad = sorted({k for k, _ in untouched.kinds} & CONTRADICTIONS) + untouched.units
    done = {}
    for seed, case in enumerate(cases()):
        if of.has(case.needs) and (spec.group != SHORT or spec.name.endswith("-1")):
            changed = case.change(of, np.random.default_rng(seed))
            wrong = told(changed, channels=case.group in ("limits", "dead"))
            done[case.name] = is_told(case, wrong), is_named(case, wrong), sorted(wrong.kinds)
    return Judged(spec, bad, sorted({q for k, q in untouched.kinds if k == "clipped"}), done)


def worn_sensors(folder: Path, jobs: int, *, each: bool) -> bool:
    """Print the tables of worn sensors; return whether all untouched ones are in order."""
    counts: dict[str, Counter[str]] = defaultdict(Counter)
    clean: dict[str, Counter[str]] = defaultdict(Counter)
    with ProcessPoolExecutor(jobs) as pool:
        for verdict in pool.map(judged, list(recordings(folder))):
            group = verdict.spec.group
            clean[group]["all"] += 1
            clean[group]["contradicted"] += bool(verdict.contradicted)
            clean[group]["clipped"] += bool(verdict.clipped)
            if each or verdict.contradicted:
                summary = (
                    f"{verdict.contradicted or 'nothing'}; clipped: {verdict.clipped or 'nothing'}"
                )
                print(f"  untouched {group} {verdict.spec.name}: {summary}", flush=True)
            where = "chosen" if group in CHOSEN else "short" if group == SHORT else "other"
            for name, (is_known, is_right, kinds) in verdict.cases.items():
                counts[name][where] += 1
                counts[name][f"{where} told"] += is_known
                counts[name][f"{where} named"] += is_right
                if each and not is_known:
                    print(f"  not told: {group} {verdict.spec.name}: {name}: {kinds}")
    print("untouched: recordings, of them said to contradict themselves, clipped")
    for group, row in clean.items():
        print(f"  {group:20} {row['all']:4} {row['contradicted']:4} {row['clipped']:4}")
    columns = ("chosen", "other", "short")
    print("made wrong: told (map named) of recordings: chosen on, others, back-steps (30 s)")
    for case in cases():
        row = counts[case.name]
        cells = [
            f"{row[f'{c} told']:3}"
            + (f" ({row[f'{c} named']})" if case.undo else "")
            + f" of {row[c]}"
            for c in columns
        ]
        print(f"  {case.name:52}" + " | ".join(f"{cell:>14}" for cell in cells))
    return not any(row["contradicted"] for row in clean.values())


def rooms(count: int) -> None:
    """Print how many channels of simulated rooms are called clipped, untouched and at a rail."""
    false, channels, railed = 0, 0, Counter()
    for seed in range(1000, 1000 + count):
        room = simulate_room(RoomOptions(channels=4, steps=6, seed=seed, random=seed % 2 == 0))
        stream, _, given = room.sources[0]
        blocks = list(given)
        channels += len(stream.channels)
        false += _clipped(stream, blocks)
        if seed % 5:
            continue
        samples = np.concatenate([b.samples for b in blocks])
        for part in (0.3, 0.5, 0.7):
            rail = _at_rails(samples, part, np.random.default_rng(seed))
            cut = [
                SignalBlock(stream, blocks[0].start_ns, i, rail[i : i + 10_000])
                for i in range(0, len(rail), 10_000)
            ]
            railed[part] += _clipped(stream, cut)
            railed["all"] += len(stream.channels) * (part == 0.3)
    print(f"simulated rooms: {false} of {channels} untouched channels called clipped")
    for part in (0.3, 0.5, 0.7):
        print(
            f"  rails at {part:g} and {0.8 * part:g} of the peak, 2 % from top to top, noise of "
            f"0.05 %: {railed[part]} of {railed['all']} channels told"
        )


def _at_rails(samples: np.ndarray, part: float, random: np.random.Generator) -> np.ndarray:
    """Return a room through an amplifier whose rails differ and wander."""
    peak = np.abs(samples).max(axis=0).astype(float)
    wander = np.repeat(random.uniform(0.98, 1.02, len(samples) // 400 + 1), 400)[
        : len(samples), None
    ]
    noise = random.normal(0, 5e-4 * part, samples.shape) * peak
    high, low = part * peak * wander + noise, -0.8 * part * peak * wander + noise
    return np.rint(np.clip(samples, low, high) * 50).astype(np.int32)


def _clipped(stream: Stream, blocks: list[SignalBlock]) -> int:
    watch = FaultScan(stream)
    for block in blocks:
        watch.recorded(block)
        watch.update(block)
    return sum(f.kind == "clipped" for f in watch.findings())


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--data", type=Path, default=Path(os.environ.get("GROUNDTRACE_DATA", "../shared/data"))
    )
    parser.add_argument("--rooms", type=int, default=300, help="simulated rooms")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--each", action="store_true", help="print what is not told, one by one")
    options = parser.parse_args()
    rooms(options.rooms)
    if not worn_sensors(options.data, options.jobs, each=options.each):
        sys.exit(1)


if __name__ == "__main__":
    main()
