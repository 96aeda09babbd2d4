"""Explaining a result, against the replay that made it: the same span, in the same process.

A simulated room with nine sensors at 20 kHz, once with every step found, once with thresholds under
which a quarter is missed: each missed step is given its reason, and the smallest change of one
parameter that finds it. CPU time, both timed in turn, medians; peak memory: bench/file_speed.py.
"""

from __future__ import annotations

import argparse
import tempfile
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from timing import alone, interleaved, on_one_core

from groundtrace.explain.why import explain_steps
from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import load_pipeline, with_settings
from groundtrace.pipeline.engine import ReplaySession, replay
from groundtrace.pipeline.results import Provenance, ResultsSink, evidence_of, read_results
from groundtrace.pipeline.source import Source
from groundtrace.simulate.recording import write
from groundtrace.simulate.room import simulate_room
from groundtrace.simulate.room_plan import RoomOptions
from groundtrace_codecs.recording import Recording

if TYPE_CHECKING:
    from groundtrace.explain.why import StepExplanation

#: What is set so that steps are missed.
SETTINGS = {"all found": [], "many missed": ["picks.ratio=9", "steps.min_channels=8"]}


def replayed(path: Path, out: Path, settings: list[str]) -> None:
    """From the recording to its results file."""
    with Recording.open(path) as recording:
        config = with_settings(load_pipeline("room-steps"), settings)
        chain = build_pipeline(config, recording.geometry)
        times = (recording.start_ns, recording.end_ns)
        site = (recording.streams, recording.geometry, recording.labels)
        recipe = chain.recipe()
        sink = ResultsSink(out, Provenance(path.name, "", *times, recipe), force=True)
        sink.open(ReplaySession(path.name, "room", *times, *site, recipe))
        replay(Source(recording), chain, [sink])
        sink.close()


def explained(results: Path) -> StepExplanation:
    """From the results file to the account of all wrong decisions."""
    return explain_steps(evidence_of(read_results(results, evidence=True)))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=120.0)
    parser.add_argument("--runs", type=int, default=5)
    options = parser.parse_args()
    alone()
    on_one_core()
    print(f"{options.seconds:g} s of 9 channels, CPU time on one core")
    print(f"{'':14}{'steps':>6}{'missed':>8}{'replay [s]':>12}{'why [s]':>9}{'why / replay':>14}")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "room.mcap"
        write(simulate_room(RoomOptions(duration_s=options.seconds, snr=12.0)), path)
        for name, settings in SETTINGS.items():
            results = Path(folder) / f"{name}.mcap"
            replayed(path, results, settings)
            explanation = explained(results)
            cases = {
                "replay": partial(replayed, path, Path(folder) / "again.mcap", settings),
                "why": partial(explained, results),
            }
            took = interleaved(cases, options.runs)
            steps = explanation.counts.tp + explanation.counts.fn
            print(f"{name:14}{steps:6}{explanation.counts.fn:8}{took['replay']:12.2f}", end="")
            print(f"{took['why']:9.2f}{took['why'] / took['replay']:14.2f}", flush=True)


if __name__ == "__main__":
    main()
