"""Steps, their types and the way ahead on stairs and of runners.

    python bench/stairs_and_runs.py --stairs FOLDER --runs FOLDER

``--stairs`` is the folder ``RawData`` of HAPT (J.-L. Reyes-Ortiz et al., UCI Machine Learning
Repository 341, CC BY 4.0): 61 recordings of 30 people who stand, sit, lie, walk, climb and descend,
a phone at the waist, 50 Hz, with the spans of each. ``--runs`` is the folder ``FinaldataSet`` of
github.com/eternalamit5/An-improved-wearable-multi-sensor-fusion-Pedestrian-Dead-Reckoning-system-for-indoor-localisation
(MIT): 15 people who stand, walk and jog with a sensor at the chest, 100 Hz. Nobody counted steps:
they are told by how the acceleration repeats itself, span by span, good for even walks.

- Steps found in each activity, by what ships and by its rivals, against those; in stillness, which
  has none; of runs also sped up.
- Types of the steps: all go ahead.
- How many recordings are said to have axes that contradict each other: none has.
- The way ahead against what the whole recording says (of a run: the walk of the same person), also
  of a recording that begins at the first stair down.

``vertical`` was chosen on people 1 to 15 of HAPT, what tells the way on those of even number.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter, defaultdict
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy import signal

import groundtrace as gt
from groundtrace_codecs.importers.run import import_recording
from groundtrace_codecs.signals import G0_MPS2

ACTIVITIES = {1: "walk", 2: "up a stair", 3: "down a stair", 4: "sit", 5: "stand", 6: "lie"}
STILL = ("sit", "stand", "lie")
ALL_STEPS = {
    "waist-steps": ("waist-steps", {}),
    "by rhythm": ("waist-steps", {"steps.method": "rhythm"}),
    "peaks": ("waist-peaks", {}),
    "zero crossings": ("waist-crossings", {}),
}
#: Sped up by so much.
FASTER = (1.0, 1.12, 1.24)
#: Quantities of a worn sensor: letter of their columns, name and unit.
WORN = (
    ("a", "acceleration", "m/s2"),
    ("g", "angular_velocity", "rad/s"),
    ("m", "magnetic_field", "a.u."),
)


class Span(NamedTuple):
    """What a person does from a time to another [s]."""

    activity: str
    start_s: float
    stop_s: float


class Walk(NamedTuple):
    """A recording, whose it is, and what is done in it."""

    path: Path
    topic: str
    rate_hz: float
    person: int
    spans: list[Span]


def written(values: np.ndarray, placement: str, out: Path, rate_hz: float = 0.0) -> Path:
    """Import three columns of each of :data:`WORN` as a user would; return the recording.

    Without a rate the first column is the time [s].
    """
    worn = WORN[: values.shape[1] // 3]
    names = [letter + axis for letter, _, _ in worn for axis in "xyz"]
    row = '  {{column = "{}{}", quantity = "{}", axis = "{}", unit = "{}"}},'
    rows = [
        row.format(letter, axis, quantity, axis, unit)
        for letter, quantity, unit in worn
        for axis in "xyz"
    ]
    time = f"rate_hz = {rate_hz:.3f}" if rate_hz else 'time = {column = "time_s", unit = "s"}'
    head = f'format = "csv"\n{time}\n[[stream]]\ntopic = "/imu/{placement}"'
    text = "\n".join([head, f'placement = "{placement}"', "columns = [", *rows, "]\n"])
    table, columns = out.with_suffix(".csv"), out.with_suffix(".toml")
    header = ",".join(names if rate_hz else ["time_s", *names])
    np.savetxt(table, values, delimiter=",", header=header, comments="", fmt="%.8g")
    columns.write_text(text, "utf-8")
    import_recording([table], out, map_path=columns)
    return out


def stairs(folder: Path, into: Path) -> list[Walk]:
    """Import HAPT."""
    labels = np.loadtxt(folder / "labels.txt", int)
    walks = []
    for path in sorted(folder.glob("acc_*.txt")):
        number, person = (int(x[-2:]) for x in path.stem.split("_")[1:])
        parts = [np.loadtxt(path), np.loadtxt(path.parent / path.name.replace("acc", "gyro"))]
        count = min(map(len, parts))
        values = np.hstack([x[:count] for x in parts])
        values[:, :3] *= G0_MPS2
        out = written(values, "waist", into / f"{path.stem}.mcap", 50.0)
        spans = [
            Span(ACTIVITIES[kind], (first - 1) / 50, last / 50)
            for of, _, kind, first, last in labels.tolist()
            if of == number and kind in ACTIVITIES
        ]
        walks.append(Walk(out, "/imu/waist", 50.0, person, spans))
    return walks


def runs(folder: Path, into: Path, faster: float = 1.0) -> list[Walk]:
    """Import walks and runs with a sensor at the chest, their samples that much faster."""
    walks = []
    for path in sorted(folder.glob("exp_*.csv")):
        _, person, _, _, activity = path.stem.split("_")
        if faster != 1 and activity != "jog":
            continue
        values = np.loadtxt(path, delimiter=",")[:, :6]
        values[:, :3] *= G0_MPS2
        values[:, 3:] = np.degrees(values[:, 3:])  # they were taken for degrees once too often
        out = written(values, "trunk", into / f"{path.stem}-{faster}.mcap", 100.0 * faster)
        name = {"walking": "walk", "standing": "stand"}.get(activity, activity)
        span = Span(name, 0.0, len(values) / 100 / faster)
        walks.append(Walk(out, "/imu/trunk", 100.0 * faster, int(person), [span]))
    return walks


def repeated(length_mps2: np.ndarray, rate_hz: float, *, fast: bool) -> float:
    """Return how many steps the length of the acceleration repeats itself by, in parts of 20 s."""
    band_hz, periods_s = ((0.6, 6.0), (0.22, 0.6)) if fast else ((0.6, 5.0), (0.35, 0.9))
    sos = signal.butter(2, band_hz, "bandpass", fs=rate_hz, output="sos")
    x = signal.sosfiltfilt(sos, length_mps2 - length_mps2.mean())
    first, last = (round(period_s * rate_hz) for period_s in periods_s)
    steps = 0.0
    for part in np.array_split(x, max(1, round(len(x) / rate_hz / 20))):
        alike = np.correlate(part, part, "full")[len(part) - 1 :]
        steps += len(part) / (first + int(alike[first:last].argmax()))
    return steps


def counted(walks: list[Walk]) -> None:
    """Print a row for each activity: how many steps each pipeline finds, and how many there are."""
    found: dict[str, Counter[str]] = defaultdict(Counter)
    odd = 0
    for walk in walks:
        recording = gt.open(walk.path)
        odd += "axes" in recording.faults.kind
        length = np.linalg.norm(recording[walk.topic].read().values[:, :3], axis=1)
        times = {
            name: gt.replay(recording, pipeline, given).steps.time_s
            for name, (pipeline, given) in ALL_STEPS.items()
        }
        for name, start_s, stop_s in walk.spans:
            row = found[name]
            row["spans"] += 1
            row["minutes"] += (stop_s - start_s) / 60
            if name not in STILL:
                inside = length[round(start_s * walk.rate_hz) : round(stop_s * walk.rate_hz)]
                row["repeated"] += repeated(inside, walk.rate_hz, fast=name == "jog")
            for pipeline, time_s in times.items():
                row[pipeline] += int(((time_s >= start_s) & (time_s < stop_s)).sum())
    for name, row in found.items():
        steps = ", ".join(f"{pipeline} {row[pipeline]}" for pipeline in ALL_STEPS)
        true = f"{row['repeated']:.0f} steps" if row["repeated"] else "no steps"
        print(
            f"  {name}: {row['spans']} spans, {row['minutes']:.0f} min, {true}; {steps}", flush=True
        )
    print(f"  axes said to contradict each other: {odd} of {len(walks)} recordings", flush=True)


class Types(NamedTuple):
    """Steps of a recording: when, of which type, and where ahead is against the reference [rad]."""

    time_s: np.ndarray
    kind: np.ndarray
    mounting_rad: np.ndarray


def types_of(path: Path) -> Types:
    """Return the types of the steps of a recording."""
    result = gt.replay(path, "step-types")
    steps, tables = result.steps, [x for x in result.candidates if "mounting_rad" in x.columns]
    typed = steps.stage == "types"
    if not tables:
        return Types(steps.time_s[typed], steps.type[typed], np.empty(0))
    at = np.searchsorted(tables[0].time_s, steps.time_s[typed])
    return Types(steps.time_s[typed], steps.type[typed], tables[0].mounting_rad[at])


def begun(walk: Walk, start_s: float) -> Path:
    """Return what a recorder that is switched on at a time would have recorded."""
    values = np.loadtxt(walk.path.with_suffix(".csv"), delimiter=",", skiprows=1)
    out, placement = walk.path.with_suffix(".begun.mcap"), walk.topic.rsplit("/", 1)[-1]
    return written(values[round(start_s * walk.rate_hz) :], placement, out, walk.rate_hz)


def middle(angles_rad: np.ndarray) -> float:
    """Return the mean direction [rad]."""
    return float(np.angle(np.exp(1j * angles_rad).mean()))


def told(walks: list[Walk]) -> None:
    """Print types and ways of all steps, and ways where a recording begins at a stair down."""
    kinds: dict[str, Counter[str]] = defaultdict(Counter)
    ways: dict[str, list[bool]] = defaultdict(list)
    true = {}
    for walk in sorted(walks, key=lambda x: x.spans[0].activity == "jog"):
        types = types_of(walk.path)
        runs_ = walk.spans[0].activity == "jog"
        if not runs_ and len(types.time_s):
            true[walk.person] = middle(types.mounting_rad)
        down = [x for x in walk.spans if x.activity == "down a stair"]
        for name, start_s, stop_s in walk.spans:
            if name not in STILL:
                inside = (types.time_s >= start_s) & (types.time_s < stop_s)
                kinds[name].update(types.kind[inside].tolist())
                turned = np.cos(types.mounting_rad[inside] - true[walk.person]) < 0
                ways[name] += turned.tolist()
        if down:
            types = types_of(begun(walk, down[0].start_s))
            turned = np.cos(types.mounting_rad - true[walk.person]) < 0
            before = types.time_s < down[0].stop_s - down[0].start_s
            ways["of recordings begun on a stair down, on it"] += turned[before].tolist()
            ways["of recordings begun on a stair down, after it"] += turned[~before].tolist()
    for name, row in kinds.items():
        print(f"  {name}: {dict(row.most_common())}")
    for name, turned in ways.items():
        print(f"  way off by more than a right angle, {name}: {sum(turned)} of {len(turned)}")


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--stairs", type=Path)
    parser.add_argument("--runs", type=Path)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        into = Path(folder)
        sets = {}
        if given.stairs:
            sets["a phone at the waist, 30 people"] = stairs(given.stairs, into)
        if given.runs:
            sets["a sensor at the chest, 15 people"] = runs(given.runs, into)
        for name, walks in sets.items():
            print(name)
            counted(walks)
            for half in (0, 1):
                print(f" types, people of {('even', 'odd')[half]} number")
                told([x for x in walks if x.person % 2 == half])
        if given.runs:
            for faster in FASTER[1:]:
                print(f"the runs, {faster:g} times as fast")
                counted(runs(given.runs, into, faster))


if __name__ == "__main__":
    main()
