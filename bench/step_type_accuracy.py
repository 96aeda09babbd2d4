"""Types of steps on real walks that go forward, and on simulated people: a table of step-types.md.

    python bench/step_type_accuracy.py --data FOLDER

The folder holds ``mobgap``, ``oxford-step`` and ``back-steps`` as published; what is absent is left
out. Everybody in them is taken to walk forward all the time. Nothing is set. Settings were chosen
on mobgap and phones in the pocket; the others were seen meanwhile (docs/accuracy.md).
"""

from __future__ import annotations

import argparse
import os
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np

from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import load_pipeline
from groundtrace.pipeline.engine import EventList, replay
from groundtrace.pipeline.source import Source
from groundtrace.simulate.gait import WalkOptions
from groundtrace.simulate.recording import write
from groundtrace.simulate.walk import simulate_walk
from groundtrace_codecs.events import StepEvent
from groundtrace_codecs.importers.run import import_recording
from groundtrace_codecs.recording import Recording
from groundtrace_recordings import map_path

#: A step answers a true one within so long [ns].
NEAR_NS = 250_000_000
SEEDS = range(501, 513)


def typed(recording: Recording) -> list[StepEvent]:
    """Return the steps with types that the pipeline finds."""
    sink = EventList()
    replay(Source(recording), build_pipeline(load_pipeline("step-types")), [sink])
    return [x for x in sink.events if isinstance(x, StepEvent) and x.stage == "types"]


def forward(files: list[tuple[Path, Path]]) -> Counter[str]:
    """Return the types of all steps of some files, those far from true ones left out."""
    counted: Counter[str] = Counter()
    for path, columns in files:
        with tempfile.TemporaryDirectory() as folder:
            out = Path(folder) / "walk.mcap"
            truth = path.parent / "truth.csv"
            given = truth if path.name == "signal.csv" else None
            import_recording([path], out, map_path=columns, truth=given)
            with Recording.open(out) as recording:
                true = np.array([x.time_ns for x in recording.labels if x.kind == "step"])
                for step in typed(recording):
                    if not len(true) or np.abs(true - step.time_ns).min() <= NEAR_NS:
                        counted[step.type] += 1
    return counted


def told(name: str, counted: Counter[str]) -> None:
    """Print a row: forward, of those with one of the four types, and how many are unknown."""
    sure = sum(counted.values()) - counted["unknown"]
    part = 100 * counted["forward"] / max(sure, 1)
    print(f"  {name}: {part:.1f} % forward of {sure}, {counted['unknown']} unknown", flush=True)


def simulated(seed: int) -> Counter[tuple[str, str]]:
    """Return how often a true type was called what."""
    counted: Counter[tuple[str, str]] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "walk.mcap"
        write(simulate_walk(WalkOptions(types=True, seed=seed)), out)
        with Recording.open(out) as recording:
            steps = typed(recording)
            times = np.array([x.time_ns for x in steps])
            for label in recording.labels:
                if label.kind == "step":
                    nearest = int(np.abs(times - label.time_ns).argmin())
                    near = abs(int(times[nearest]) - label.time_ns) <= NEAR_NS
                    counted[label.label, steps[nearest].type if near else "missed"] += 1
    return counted


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--data", type=Path, default=Path(os.environ.get("GROUNDTRACE_DATA", "../shared/data"))
    )
    data = parser.parse_args().data
    print("real walks, all forward")
    lower, phone = map_path("mobgap-test11.toml"), map_path("oxford-step-validation.toml")
    for path in sorted(data.glob("mobgap/*/*/data.mat")):
        told(f"mobgap {path.parts[-3]} (chosen on)", forward([(path, lower)]))
    for path in sorted(data.glob("oxford-step/validation/*.csv")):
        told(f"oxford-step {path.stem.split('_')[1]}", forward([(path, phone)]))
    backs = sorted(data.glob("back-steps/*/signal.csv"))
    if backs:
        told("back-steps", forward([(path, path.parent / "map.toml") for path in backs]))
    for seeds in (SEEDS[:6], SEEDS[6:]):
        counted = sum((simulated(seed) for seed in seeds), Counter())
        print(f"simulated people, seeds {seeds[0]} to {seeds[-1]}")
        for kind in ("forward", "backward", "left", "right"):
            row = {called: n for (true, called), n in sorted(counted.items()) if true == kind}
            print(f"  {kind}: {row}")


if __name__ == "__main__":
    main()
