"""Strides and tracks of real foot recordings through one named pipeline: the table of inertial.md.

    python bench/foot_accuracy.py --data FOLDER

The folder holds ``llio-pyshoe`` and ``xio-gait`` as published; what is absent is left out. Nothing
is set. It fails where a stride is missed or false, or an end is off by more than two percent.

Three settings were chosen on five of these recordings (docs/accuracy.md).
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy import signal

from groundtrace.evaluation.tracks import score_tracks
from groundtrace.pipeline.config import build_pipeline, load_pipeline
from groundtrace.pipeline.engine import replay
from groundtrace.pipeline.source import Source
from groundtrace_codecs.events import Label, StepEvent, TrackPoint
from groundtrace_codecs.importers.run import import_recording
from groundtrace_codecs.recording import Recording
from groundtrace_recordings import map_path

if TYPE_CHECKING:
    from groundtrace.evaluation.positions import ClosureScore
    from groundtrace_codecs.signals import SignalBlock

LIMIT_PERCENT = 2.0
#: Strides of recordings whose files do not tell: groups of swings in the angular rate.
STRIDES = {"short_walk": 16}
RATES_HZ = (None, 100.0, 50.0)


class Said:
    """Steps and points of a replay."""

    def __init__(self) -> None:
        self.steps: list[StepEvent] = []
        self.points: list[TrackPoint] = []

    def write(self, item: object) -> None:
        if isinstance(item, StepEvent):
            self.steps.append(item)
        elif isinstance(item, TrackPoint) and item.stage == "track.smoothed":
            self.points.append(item)

    def close(self) -> None:
        pass


def recordings(folder: Path) -> list[tuple[Path, str]]:
    """Return the files that are there, with their maps."""
    shoes = [(path, "llio-pyshoe.toml") for path in sorted(folder.glob("llio-pyshoe/*.mat"))]
    return shoes + [(path, "xio-gait.toml") for path in sorted(folder.glob("xio-gait/*.csv"))]


def read(path: Path, columns: str) -> tuple[SignalBlock, tuple[Label, ...]]:
    """Return a recording as one block; one without places returned to where it began."""
    with tempfile.TemporaryDirectory() as scratch:
        file = Path(scratch) / "rec.mcap"
        import_recording([path], file, map_path=map_path(columns))
        with Recording.open(file) as recording:
            (block,) = Source(recording, block_s=1e5)
            ends = (block.start_ns, block.last_ns)
            returned = tuple(Label(t, "waypoint", x_m=0.0, y_m=0.0) for t in ends)
            return block, recording.labels or returned


def at(block: SignalBlock, rate_hz: float | None) -> SignalBlock:
    """Return the block sampled slower, after a low-pass as sensors have one."""
    if rate_hz is None:
        return block
    fewer = signal.resample_poly(block.values, round(rate_hz), round(block.stream.rate_hz), axis=0)
    channels = tuple(replace(c, scale=1.0) for c in block.stream.channels)
    exact = rate_hz * block.stream.rate_hz / round(block.stream.rate_hz)
    stream = replace(block.stream, channels=channels, rate_hz=exact)
    return replace(block, stream=stream, samples=fewer)


def figures(
    block: SignalBlock, labels: tuple[Label, ...]
) -> tuple[list[StepEvent], ClosureScore | None]:
    """Return the strides of a recording, and how its track closes."""
    said = Said()
    replay([block], build_pipeline(load_pipeline("foot-inertial")), [said])
    score = score_tracks(labels, said.points)
    return said.steps, None if score is None else score.closure


def strides_of(name: str, labels: tuple[Label, ...], steps: list[StepEvent]) -> tuple[int, int]:
    """Return how many true strides have just one step, and how many there are."""
    if name in STRIDES:
        return min(len(steps), STRIDES[name]), STRIDES[name]
    if len(labels) < 3:
        return 0, 0
    edges = [label.time_ns for label in labels]
    counts = np.histogram([step.time_ns for step in steps], edges)[0]
    return int((counts == 1).sum()), len(edges) - 1


def row(path: Path, columns: str, rate_hz: float | None) -> bool:
    """Print the figures of one recording; return whether it passes."""
    block, labels = read(path, columns)
    thinned = at(block, rate_hz)
    steps, found = figures(thinned, labels)
    right, strides = strides_of(path.stem, labels, steps)
    whole = right == strides and (not strides or len(steps) == strides)
    good = found is not None and found.percent <= LIMIT_PERCENT and whole
    cells = [
        path.stem[:24],
        f"{thinned.stream.rate_hz:.0f} Hz",
        f"{right}/{strides} ({len(steps)})",
    ]
    if found is not None:
        cells += [f"{found.walked_m:.1f} m", f"{found.apart_m:.2f} ({found.true_apart_m:.2f}) m"]
        cells.append(f"{found.percent:.2f} %")
        rmse = found.aligned_rmse_m
        cells.append("-" if rmse is None else f"{rmse:.2f} m")
    verdict = "pass" if good else "FAIL"
    print("  ".join(f"{cell:>16}" for cell in [*cells, verdict]), flush=True)
    return good


def main() -> None:
    """Print the table; fail where a recording at its own rate does."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--data", type=Path, default=Path(os.environ.get("GROUNDTRACE_DATA", "../shared/data"))
    )
    options = parser.parse_args()
    print("recording, rate, strides with one step (steps), walked, end (truth), closure, shape")
    found = recordings(options.data)
    passed = []
    for rate_hz in RATES_HZ:
        passed += [(rate_hz, row(path, columns, rate_hz)) for path, columns in found]
    if not all(good for rate_hz, good in passed if rate_hz is None):
        sys.exit(1)


if __name__ == "__main__":
    main()
