"""Sweep of 2520 settings of a recording, as recorded seconds decided and scored per second.

Detector gates alone (a walker's waist, or ``--results`` of your own), and a chain through an
associator (a room). The same settings decided one by one, each from the start, stand beside it:
both are timed in turn, in one process, and the medians are compared.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

from timing import alone, on_one_core

from groundtrace.explain.redecide import Grid, OfflineDecider, make_grid, parse_axis
from groundtrace.explain.sweep import Subject, count, measure_evidence
from groundtrace.pipeline.config import load_pipeline
from groundtrace.simulate.gait import WalkOptions
from groundtrace.simulate.recording import write
from groundtrace.simulate.room import simulate_room
from groundtrace.simulate.room_plan import RoomOptions
from groundtrace.simulate.walk import simulate_walk

if TYPE_CHECKING:
    from groundtrace.pipeline.results import Evidence

WAIST = (
    "steps.swing=0.05:1.5:14",
    "steps.share=0.05:0.5:6",
    "steps.dominance=0.3:0.8:6",
    "steps.rhythm=0.2:0.6:5",
)
ROOM = (
    "picks.ratio=5:12:15",
    "picks.refractory_s=0.1:0.4:4",
    "steps.min_channels=2:8:7",
    "steps.refractory_s=0.1:0.6:6",
)
#: So many settings are decided one by one.
SINGLE = 50


def swept_s(evidence: Evidence, grid: Grid) -> float:
    """Wall time of the whole sweep."""
    began = time.perf_counter()
    count([Subject(evidence, ())], grid)
    return time.perf_counter() - began


def single_s(evidence: Evidence, grid: Grid) -> float:
    """Wall time of some settings, each decided from the start."""
    redecider = OfflineDecider(evidence)
    keys = [(axis.stage, axis.parameter) for axis in grid.axes]
    began = time.perf_counter()
    for values in grid.rows[:: len(grid) // SINGLE][:SINGLE]:
        redecider.matching(dict(zip(keys, values, strict=True)))
    return time.perf_counter() - began


def report(name: str, evidence: Evidence, texts: tuple[str, ...], runs: int) -> None:
    """Print one row."""
    grid = make_grid([parse_axis(text, evidence.config) for text in texts])
    recorded_s = (evidence.end_ns - evidence.start_ns) / 1e9
    swept_s(evidence, grid)
    times = [(swept_s(evidence, grid), single_s(evidence, grid)) for _ in range(runs)]
    swept = statistics.median(t[0] for t in times) / len(grid)
    single = statistics.median(t[1] for t in times) / SINGLE
    label, rate = f"{name}, {recorded_s:.0f} s", recorded_s / swept
    print(f"{label:34}{len(grid):10}{swept * 1e3:15.3f}{rate:18.0f}{single / swept:15.1f}")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=34.0)
    parser.add_argument("--runs", type=int, default=5)
    options = parser.parse_args()
    alone()
    on_one_core()
    print(
        f"{'':34}{'settings':>10}{'ms per setting':>15}{'recorded s per s':>18}{'times singly':>15}"
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "walk.mcap"
        write(simulate_walk(WalkOptions(duration_s=options.seconds)), path)
        evidence = measure_evidence(path, load_pipeline("waist-steps"))
        report("gates of a detector", evidence, WAIST, options.runs)
        path = Path(folder) / "room.mcap"
        write(simulate_room(RoomOptions(duration_s=options.seconds)), path)
        evidence = measure_evidence(path, load_pipeline("room-footsteps"))
        report("gates and an associator", evidence, ROOM, options.runs)


if __name__ == "__main__":
    main()
