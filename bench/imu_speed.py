"""Pipelines of a body-worn IMU at 100 Hz, from file to decisions, as recorded seconds per second.

Each pipeline replays a simulated walk of its own placement several times, warm, and the median CPU
time counts. Reading alone stands beside it: the same file, every stream, no pipeline.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from timing import median_s

from groundtrace.engine import replay
from groundtrace.pipeline import build_pipeline, load_pipeline
from groundtrace.simulate import WalkOptions, simulate_walk, write
from groundtrace.source import Source
from groundtrace_codecs.recording import Recording

if TYPE_CHECKING:
    from collections.abc import Callable

PIPELINES = {
    "waist-steps": "waist",
    "step-types": "waist",
    "heading": "waist",
    "pedestrian": "waist",
    "foot-inertial": "foot",
}


def replayed(path: Path, pipeline: str, block_s: float) -> None:
    """From the file to decisions."""
    with Recording.open(path) as recording:
        chain = build_pipeline(load_pipeline(pipeline), recording.geometry)
        replay(Source(recording, block_s=block_s), chain, [])


def read(path: Path, block_s: float) -> None:
    """The blocks of a file, and nothing else."""
    with Recording.open(path) as recording:
        for _ in Source(recording, block_s=block_s):
            pass


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--runs", type=int, default=3)
    options = parser.parse_args()
    print(f"{options.seconds:g} s at 100 Hz; recorded seconds per second of CPU time")
    print(f"{'':16}{'blocks of 0.5 s':>16}{'of 10 s':>10}")
    with tempfile.TemporaryDirectory() as folder:
        paths = {}
        for placement in sorted(set(PIPELINES.values())):
            paths[placement] = Path(folder) / f"{placement}.mcap"
            walk = WalkOptions(duration_s=options.seconds, placement=placement)
            write(simulate_walk(walk), paths[placement])
        cases: dict[str, Callable[[float], None]] = {
            "reading alone": lambda s: read(paths["waist"], s)
        }
        for name, placement in PIPELINES.items():
            cases[name] = lambda s, n=name, p=placement: replayed(paths[p], n, s)  # type: ignore[misc]
        for name, case in cases.items():
            rates = [
                options.seconds / median_s(lambda c=case, s=s: c(s), options.runs)  # type: ignore[misc]
                for s in (0.5, 10.0)
            ]
            print(f"{name:16}{rates[0]:16.0f}{rates[1]:10.0f}", flush=True)


if __name__ == "__main__":
    main()
