"""One long recording on one worker and on two: an hour of 16 channels at 20 kHz.

Each run is the command, a process with its workers: in one go, in spans on one worker, and on two.
They take turns; least times by the clock and of processors count, and ratios within a round. What
one go decides and what spans decide is compared.

Run: python bench/split_speed.py --minutes 60 --rounds 3 [--recording REC.mcap]
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from big_recording import write_big
from timing import alone

from groundtrace.pipeline.results import read_results
from groundtrace.pipeline.split import alike

WAYS = {
    "in one go": (),
    "one worker": ("--engine", "local", "--workers", "1"),
    "two workers": ("--engine", "local", "--workers", "2"),
}


def taken_s(command: list[str]) -> tuple[float, float]:
    """Return how long a command takes by the clock, and of processors, its workers' too [s]."""
    began, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, check=True, capture_output=True)
    clock_s, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    return clock_s, sum(after[:2]) - sum(before[:2])


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=int, default=60)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--recording", type=Path)
    parser.add_argument("--pipeline", default="room-steps")
    options = parser.parse_args()
    alone()
    with tempfile.TemporaryDirectory() as folder:
        path = options.recording or Path(folder, "hour.mcap")
        if options.recording is None:
            write_big(path, options.minutes, channels=16)
        taken: dict[str, list[tuple[float, float]]] = {way: [] for way in WAYS}
        results = {way: Path(folder, f"{way}.results.mcap") for way in WAYS}
        for _ in range(options.rounds):
            for way, engine in WAYS.items():
                command = [str(Path(sys.executable).with_name("groundtrace")), "replay", str(path)]
                command += ["--pipeline", options.pipeline, "--no-viewer", "--quiet", "--force"]
                command += ["--out", str(results[way]), *engine]
                taken[way].append(taken_s(command))
        whole = read_results(results["in one go"]).events
        print(f"{'':12}{'clock [s]':>10}{'CPU [s]':>9}  of all rounds, by the clock")
        for way, runs in taken.items():
            least = [min(run[i] for run in runs) for i in (0, 1)]
            said = " ".join(f"{clock_s:.1f}" for clock_s, _ in runs)
            same = alike(whole, read_results(results[way]).events)
            note = "" if same else "  DECIDED OTHERWISE"
            print(f"{way:12}{least[0]:10.1f}{least[1]:9.1f}  {said}{note}")
        for slow, fast in (("one worker", "two workers"), ("in one go", "two workers")):
            pairs = zip(taken[slow], taken[fast], strict=True)
            ratios = " ".join(f"{one[0] / two[0]:.2f}" for one, two in pairs)
            best = min(run[0] for run in taken[slow]) / min(run[0] for run in taken[fast])
            print(f"{slow} over {fast}: {best:.2f} of least times; by round {ratios}")


if __name__ == "__main__":
    main()
