"""Pipelines of a body-worn IMU at 100 Hz: recorded seconds per second of CPU time.

Each pipeline replays a simulated walk of its own placement several times, warm, on one core, as the
command line does; the median CPU time counts: from file to decisions, in blocks as ``replay`` joins
them, and from blocks of several lengths that were read before. Reading alone stands beside it: the
same file, every stream, no pipeline. A last line compares ``waist-steps`` with itself without the
second network of the score, in turn: candidates then keep their likeness as score.
"""

from __future__ import annotations

import argparse
import tempfile
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING
from unittest import mock

import numpy as np
from timing import alone, interleaved, median_s, on_one_core

from groundtrace.detectors import adaptive
from groundtrace.detectors.step_score import INPUTS, ScorePeaks
from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import load_pipeline
from groundtrace.pipeline.engine import replay
from groundtrace.pipeline.source import Source
from groundtrace.simulate.gait import WalkOptions
from groundtrace.simulate.recording import write
from groundtrace.simulate.walk import simulate_walk
from groundtrace_codecs.recording import Recording

if TYPE_CHECKING:
    from collections.abc import Callable

    from groundtrace.detectors.step_score import Scores
    from groundtrace_codecs.events import Gap
    from groundtrace_codecs.signals import SignalBlock

    Array = np.ndarray

PIPELINES = {
    "waist-steps": "waist",
    "step-types": "waist",
    "heading": "waist",
    "pedestrian": "waist",
    "foot-inertial": "foot",
}
#: Lengths of the blocks that were read before [s].
LENGTHS_S = (0.5, 2.0, 10.0, 30.0)


def replayed(path: Path, pipeline: str) -> None:
    """From the file to decisions."""
    with Recording.open(path) as recording:
        chain = build_pipeline(load_pipeline(pipeline), recording.geometry)
        replay(Source(recording), chain, [])


def read(path: Path, block_s: float | None = None) -> list[SignalBlock | Gap]:
    """The blocks of a file."""
    with Recording.open(path) as recording:
        return list(Source(recording, block_s=block_s))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--runs", type=int, default=3)
    options = parser.parse_args()
    alone()
    on_one_core()
    print(f"{options.seconds:g} s at 100 Hz; recorded seconds per second of CPU time")
    lengths = "".join(f"{f'{x:g} s':>8}" for x in LENGTHS_S)
    print(f"{'':16}{'from file':>10}{lengths}")
    with tempfile.TemporaryDirectory() as folder:
        for name, placement in PIPELINES.items():
            path = Path(folder) / f"{placement}.mcap"
            if not path.exists():
                walk = WalkOptions(duration_s=options.seconds, placement=placement)
                write(simulate_walk(walk), path)
                alone_s = median_s(partial(read, path), options.runs)
                print(f"{f'reading, {placement}':16}{options.seconds / alone_s:10.0f}", flush=True)
            cases = [partial(replayed, path, name)]
            cases += [partial(preloaded, read(path, x), name) for x in LENGTHS_S]
            rates = [options.seconds / median_s(case, options.runs) for case in cases]
            columns = "".join(f"{rate:8.0f}" for rate in rates[1:])
            print(f"{name:16}{rates[0]:10.0f}{columns}", flush=True)
        items = read(Path(folder) / "waist.mcap", LENGTHS_S[-1])
        both = partial(preloaded, items, "waist-steps")
        times = interleaved({"both": both, "first": partial(without_second, both)}, options.runs)
        ratio = times["both"] / times["first"]
        print(f"waist-steps: {ratio:.2f} times the CPU time of its first network alone")


class Unjudged:
    """Candidates by the first network alone, in place of what brings surroundings together."""

    def __init__(self) -> None:
        self._peaks = ScorePeaks()

    def __call__(self, _: Array, point_scores: Scores, step_s: Array) -> tuple[Array, Array]:
        """Take points; return candidates, with surroundings that nobody looks at."""
        return _unseen(self._peaks(point_scores, step_s))

    def flush(self) -> tuple[Array, Array]:
        """Return those that waited."""
        return _unseen(self._peaks.flush())


def _unseen(rows: Array) -> tuple[Array, Array]:
    return rows, np.empty((len(rows), INPUTS))


def without_second(case: Callable[[], None]) -> None:
    """Run a case with the likeness of each candidate taken for its score."""
    with mock.patch.multiple(adaptive, Surroundings=Unjudged, judged=_likeness):
        case()


def _likeness(rows: Array, *_: object) -> Array:
    return np.insert(rows, 2, rows[:, 1], axis=1)


def preloaded(items: list[SignalBlock | Gap], pipeline: str) -> None:
    """From blocks in memory to decisions."""
    replay(items, build_pipeline(load_pipeline(pipeline)), [])


if __name__ == "__main__":
    main()
