"""Places of footsteps in random simulated rooms by room-footsteps: the tables of rooms.md.

    python bench/room_accuracy.py [--first 21 --last 40] [--markdown]

Each room is simulated to a recording, replayed and scored, with the array stage as shipped and
with onsets alone; a few of them again in a floor where waves do not disperse. Ends with the
targets and says which are reached; exit status 1 where one is not.

No setting was chosen on these seeds (docs/accuracy.md).
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from groundtrace.evaluation.positions import (
    found_places,
    match_places,
    score_positions,
    true_places,
)
from groundtrace.localizers.wave_physics import Plate
from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import PipelineConfig, load_pipeline, with_settings
from groundtrace.pipeline.engine import replay
from groundtrace.pipeline.source import Source
from groundtrace.simulate.recording import Simulation, write
from groundtrace.simulate.room import simulate_room
from groundtrace.simulate.room_plan import RoomOptions
from groundtrace_codecs.events import Fix, TrackPoint
from groundtrace_codecs.recording import Recording
from groundtrace_recordings import path_of

#: Smoothed track, median [m]; SO-TDOA, rms [m].
TRACK_M, SO_TDOA_M = 0.25, 0.8
LOCALIZERS = ("so-tdoa", "hyperbolic", "power-law", "self-calibrating", "place")
SNR = 40.0


@dataclass(frozen=True)
class Steady(Plate):
    """A floor in which no wave disperses: the slab's waveform at 1 m, later with distance."""

    velocity_mps: float = 500.0

    def response(self, distance_m: np.ndarray, frequency_hz: np.ndarray) -> np.ndarray:
        near = Plate.response(self, np.ones(1), frequency_hz)
        later = np.multiply.outer(distance_m - 1.0, frequency_hz) / self.velocity_mps
        return near * np.exp(-2j * np.pi * later) / np.sqrt(np.maximum(distance_m, 0.3))[:, None]


@dataclass(frozen=True)
class Room:
    """What one room is, and the errors by localizer: cep50, cep95, rms; of the track: median."""

    name: str
    sensors: int
    errors: dict[str, tuple[float, float, float]]
    track: float


class Kept:
    """A sink that keeps places."""

    def __init__(self) -> None:
        self.fixes: list[Fix] = []
        self.points: list[TrackPoint] = []

    def write(self, item: object) -> None:
        if isinstance(item, Fix):
            self.fixes.append(item)
        elif isinstance(item, TrackPoint) and item.stage.endswith("smoothed"):
            self.points.append(item)


def onsets_alone(config: PipelineConfig) -> PipelineConfig:
    """The pipeline without its array stage, arrivals growing as onsets do on a plate."""
    stages = [s for s in config.stage if s.use != "gcc-phat"]
    bent = [
        replace(s, parameters={k: v for k, v in s.parameters.items() if k != "exponent"})
        for s in stages
    ]
    return replace(config, stage=tuple(bent))


def steady(simulation: Simulation) -> Simulation:
    """The same walk over a floor where waves do not disperse."""
    (stream, kind, signal) = simulation.sources[0]
    field = signal.field
    floor = replace(field, synthesis=replace(field.synthesis, plate=Steady()))
    medium = replace(simulation.geometry.medium, velocity_mps=Steady.velocity_mps)
    site = replace(simulation.geometry, medium=medium)
    return replace(
        simulation, sources=[(stream, kind, replace(signal, field=floor))], geometry=site
    )


def scored(path: Path, config: PipelineConfig, name: str) -> Room:
    """Replay a recording and score it."""
    sink = Kept()
    with Recording.open(path) as opened:
        replay(Source(opened), build_pipeline(config, opened.geometry), [sink])
        truth, sensors = true_places(opened.labels), len(opened.geometry.sensors)
        score = score_positions(opened.labels, sink.fixes)
    by = {s.group: (s.cep50_m, s.cep95_m, s.rmse_m) for s in score.by_stage}
    points = sorted(sink.points, key=lambda p: p.time_ns)
    estimated = found_places(points)
    pairs = match_places(truth, estimated, 0.12)
    off = np.hypot(*(estimated.xy[pairs[:, 1]] - truth.xy[pairs[:, 0]]).T)
    return Room(name, sensors, by, float(np.median(off)) if len(off) else np.nan)


def described(simulation: Simulation) -> str:
    """Sides, shoe and walls of a room."""
    settings, outline = simulation.metadata["simulation"], np.array(simulation.geometry.outline)
    x, y = np.ptp(outline, axis=0)
    shape = "L " if len(np.unique(outline, axis=0)) > 4 else ""
    return f"{shape}{x:.1f} x {y:.1f}, {settings['shoe']}, {settings['walls']}"


def simulated(
    seeds: range, configs: dict[str, PipelineConfig], *, disperses: bool = True
) -> dict[str, list[Room]]:
    """Simulate, replay and score rooms with each of the pipelines."""
    rooms: dict[str, list[Room]] = {name: [] for name in configs}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "room.mcap"
        for seed in seeds:
            made = simulate_room(RoomOptions(seed=seed, snr=SNR, random=True))
            made = made if disperses else steady(made)
            write(made, path, force=True)
            for name, config in configs.items():
                rooms[name].append(scored(path, config, f"{seed} | {described(made)}"))
    return rooms


def cells(room: Room) -> str:
    """One row of the table: median / 95 % / rms of each localizer, median of the track."""
    errors = (room.errors.get(name, (np.nan,) * 3) for name in LOCALIZERS)
    texts = [" / ".join(f"{e:.2f}" for e in triple) for triple in errors]
    return " | ".join([*texts, f"{room.track:.2f}"])


def median(rooms: list[Room], name: str = "median of all") -> Room:
    """The median over rooms of every figure."""
    errors = {
        key: tuple(np.nanmedian([r.errors.get(key, (np.nan,) * 3) for r in rooms], axis=0))
        for key in LOCALIZERS
    }
    sensors = round(float(np.median([r.sensors for r in rooms])))
    return Room(name, sensors, errors, float(np.nanmedian([r.track for r in rooms])))


def table(title: str, rooms: list[Room], *, every: bool = True) -> None:
    """Print a table of rooms, and medians by number of sensors."""
    print(f"\n{title}\n")
    print(f"| seed | room [m], shoe, walls | sensors | {' | '.join(LOCALIZERS)} | track |")
    print("|" + " --- |" * (4 + len(LOCALIZERS)))
    for room in rooms if every else ():
        print(f"| {room.name} | {room.sensors} | {cells(room)} |")
    for name, low, high in (("4", 4, 4), ("5 to 8", 5, 8), ("9 or more", 9, 99), ("all", 0, 99)):
        some = [r for r in rooms if low <= r.sensors <= high]
        if some:
            print(f"| median | {len(some)} rooms | {name} | {cells(median(some))} |")


def bundled(configs: dict[str, PipelineConfig]) -> dict[str, Room]:
    """The bundled walk, of 9 sensors on 5.4 m x 5.4 m without walls."""
    path = path_of("room-walk.mcap")
    return {name: scored(path, config, "bundled") for name, config in configs.items()}


def verdict(room: Room, rooms: list[Room]) -> bool:
    """Print the targets and whether they are reached."""
    median_room, good = median(rooms), True
    figures = (
        ("smoothed track, median, bundled", room.track, TRACK_M),
        ("smoothed track, median, median of rooms", median_room.track, TRACK_M),
        ("SO-TDOA, rms, bundled", room.errors["so-tdoa"][2], SO_TDOA_M),
        ("SO-TDOA, rms, median of rooms", median_room.errors["so-tdoa"][2], SO_TDOA_M),
    )
    print()
    for what, error_m, target in figures:
        good &= error_m <= target
        print(f"{'pass' if error_m <= target else 'FAIL'}  {what}: {error_m:.2f} m (<= {target:g})")
    return good


def main() -> None:
    """Print the tables and the targets."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--first", type=int, default=21)
    parser.add_argument("--last", type=int, default=40)
    parser.add_argument("--pipeline", default="room-footsteps")
    options = parser.parse_args()
    shipped = load_pipeline(options.pipeline)
    configs = {"as shipped": shipped, "onsets alone": onsets_alone(shipped)}
    seeds = range(options.first, options.last + 1)
    print("median / 95 % / rms of each localizer, median of the smoothed track [m]")
    here, rooms = bundled(configs), simulated(seeds, configs)
    for name in configs:
        print(f"\nbundled, {name}: {cells(here[name])}")
        table(f"{options.pipeline}, {name}", rooms[name])
    even = {
        "dispersion = 1": with_settings(shipped, ["arrivals.dispersion=1"]),
        "as shipped": shipped,
        "onsets alone": configs["onsets alone"],
    }
    for name, some in simulated(seeds[:10], even, disperses=False).items():
        table(f"waves that do not disperse, 500 m/s: {name}", some, every=False)
    sys.exit(0 if verdict(here["as shipped"], rooms["as shipped"]) else 1)


if __name__ == "__main__":
    main()
