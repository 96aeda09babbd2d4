"""Places of impacts on a real floor that nothing was chosen on.

    python bench/real_floor.py --drops classroom_no_base_localization_Tennis.mat [--orders 5]

The file is ``Software/VibLocalization`` of github.com/dandanpan/VibrationSensingDocumentation: a
tennis ball dropped 39 times at four places of a classroom of 4 by 6 m, a geophone in each corner,
10 bits at 6.5 kHz, 150 ms of each drop, clipped at the near sensors. All places are surveyed. The
drops are set 1.5 s apart into noise that is pieced together from what precedes them, as they were
recorded and in random orders, and replayed through room-footsteps, as shipped and with onsets
alone. The simplest rival is the middle of the room.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from planted import Take
from room_laws import Errors, print_table, score
from scipy.io import loadmat

from groundtrace.pipeline.config import load_pipeline, with_settings
from groundtrace.simulate.recording import START_NS
from groundtrace_codecs.events import Label
from groundtrace_codecs.geometry import Geometry, Sensor
from groundtrace_codecs.signals import NS_PER_S, Channel, Stream

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

PIPELINE, RATE_HZ, APART_S = "room-footsteps", 6500.0, 1.5
WAYS = {"as shipped": (), "onsets alone": ("arrivals.max_misclosure_s=0",)}
#: Samples of each drop that precede it for certain, and those over which it fades in and out.
LEAD, RISE, FALL = 240, 65, 195
#: What is over this is the impact [counts].
IMPACT = 30.0


@dataclass
class Drop:
    """One drop: samples, shape (n, 4), and its place and the sensors' [m]."""

    samples: Array
    place: Array
    sensors: Array


def drops_of(path: Path) -> list[Drop]:
    """Read the drops, each channel by its own clock brought to one grid."""
    drops = []
    for cell in loadmat(path)["Local_sig"][0]:
        record: Any = cell[0, 0]
        times = [np.ravel(t).astype(np.float64) for t in np.ravel(record["ts"])]
        values = [np.ravel(v).astype(np.float64) for v in np.ravel(record["sig"])]
        begin, end = max(t[0] for t in times), min(t[-1] for t in times)
        grid = np.arange(begin, end, 1e6 / RATE_HZ)  # microseconds
        samples = np.array(
            [np.interp(grid, t, v - v[:LEAD].mean()) for t, v in zip(times, values, strict=True)]
        ).T
        sensors = np.array([np.ravel(record[f"Sloc{n}"]) for n in range(1, 5)], np.float64)
        drops.append(Drop(samples, np.ravel(record["groundtruth"]).astype(np.float64), sensors))
    return drops


def noise_of(drops: Sequence[Drop], count: int, rng: np.random.Generator) -> Array:
    """Return noise of what precedes the drops, pieces overlapping, shape (count, 4)."""
    noise = np.zeros((count + LEAD, 4))
    fade = np.sin(np.pi * (np.arange(LEAD) + 0.5) / LEAD)[:, None]
    for at in range(0, count, LEAD // 2):
        for channel in range(4):
            lead = drops[rng.integers(len(drops))].samples[:LEAD, channel, None]
            noise[at : at + LEAD, channel] += (lead * fade)[:, 0]
    return noise[:count]


def take_of(drops: Sequence[Drop], order: Sequence[int], rng: np.random.Generator) -> Take:
    """Return the drops in an order as one recording, in which each is a step."""
    samples = noise_of(drops, round((len(order) * APART_S + 1) * RATE_HZ), rng)
    labels = []
    for number, index in enumerate(order):
        drop, at = drops[index], round((1 + number * APART_S) * RATE_HZ)
        share = np.ones((len(drop.samples), 1))
        share[:RISE, 0], share[-FALL:, 0] = np.linspace(0, 1, RISE), np.linspace(1, 0, FALL)
        span = slice(at, at + len(share))
        samples[span] = samples[span] * np.sqrt(1 - share**2) + drop.samples * share
        first = int(np.flatnonzero((np.abs(drop.samples) > IMPACT).any(axis=1))[0])
        time_ns = START_NS + round((at + first) / RATE_HZ * NS_PER_S)
        labels.append(Label(time_ns, "step", x_m=drop.place[0], y_m=drop.place[1]))
    names = ("G1", "G2", "G3", "G4")
    places = drops[0].sensors.tolist()
    sensors = tuple(Sensor(n, n, *place) for n, place in zip(names, places, strict=True))
    stream = Stream("/geophones", tuple(Channel(n, "seismic", "count") for n in names), RATE_HZ)
    room = ((0.0, 0.0), (4.0, 0.0), (4.0, 6.0), (0.0, 6.0))
    return Take(stream, "i16le", samples, START_NS, labels, Geometry(sensors, room))


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--drops", type=Path, required=True)
    parser.add_argument("--orders", type=int, default=5, help="random ones beside the recorded")
    options = parser.parse_args()
    drops, rng = drops_of(options.drops), np.random.default_rng(1)
    orders = [np.arange(len(drops)), *(rng.permutation(len(drops)) for _ in range(options.orders))]
    takes = [take_of(drops, order.tolist(), rng) for order in orders]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "floor.mcap"
        for way, settings in WAYS.items():
            config = with_settings(load_pipeline(PIPELINE), list(settings))
            tables: dict[str, Errors] = {}
            said: Counter[str] = Counter()
            for take in takes:
                path.unlink(missing_ok=True)
                take.write(path)
                found, notes = score(path, config)
                for stage, errors in found.items():
                    tables.setdefault(stage, Errors())
                    tables[stage] += errors
                said.update({note.source for note in notes if note.level == "WARN"})
            print_table(f"{way}, {len(takes)} orders of {len(drops)} drops", tables)
            print("warned by " + ", ".join(f"{s} in {n}" for s, n in sorted(said.items())))


if __name__ == "__main__":
    main()
