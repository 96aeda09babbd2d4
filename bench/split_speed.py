"""One long recording on one worker and on two: an hour of 16 channels at 20 kHz.

Each run is the command, a process with its workers: in one go, in spans on one worker, both on one
core, and in spans on two workers and all cores. They take turns; least times by the clock and of
processors count, those of the process that joins and of its workers apart, and ratios within a
round. What one go decides and what spans decide is compared.

By the clock a ratio means something on a machine with nothing else to do. Processor time does in
any case: one core takes the sum of both parts, two cores take half of it at least, and the part
that joins at least, with however many workers.

Run: python bench/split_speed.py --minutes 60 --rounds 3 [--recording REC.mcap]
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from big_recording import write_big
from timing import alone

from groundtrace.pipeline.results import read_results
from groundtrace.pipeline.split import same_events

#: Arguments, and on how many cores; 0: all there are.
WAYS: dict[str, tuple[tuple[str, ...], int]] = {
    "in one go": ((), 1),
    "one worker": (("--engine", "local", "--workers", "1"), 1),
    "two workers": (("--engine", "local", "--workers", "2"), 0),
}
#: The command, which tells at its end how long it took of processors, itself and its workers.
COMMAND = """
import resource, sys
from groundtrace.cli.main import main
try:
    main(sys.argv[1:])
finally:
    for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN):
        print(sum(resource.getrusage(who)[:2]))
"""


def taken_s(arguments: list[str], cores: int) -> tuple[float, float, float]:
    """Return how long a command takes by the clock, and of processors: itself, and workers [s]."""
    allowed = sorted(os.sched_getaffinity(0))
    os.sched_setaffinity(0, allowed[: cores or len(allowed)])
    began = time.perf_counter()
    call = [sys.executable, "-c", COMMAND, *arguments]
    output = subprocess.run(call, check=True, capture_output=True, text=True).stdout
    clock_s = time.perf_counter() - began
    os.sched_setaffinity(0, allowed)
    main_s, workers = map(float, output.split()[-2:])
    return clock_s, main_s, workers


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
        taken: dict[str, list[tuple[float, float, float]]] = {way: [] for way in WAYS}
        results = {way: Path(folder, f"{way}.results.mcap") for way in WAYS}
        for _ in range(options.rounds):
            for way, (engine, cores) in WAYS.items():
                call = ["replay", str(path), "--pipeline", options.pipeline, "--no-viewer"]
                call += ["--quiet", "--force", "--out", str(results[way]), *engine]
                taken[way].append(taken_s(call, cores))
        unsplit = read_results(results["in one go"]).events
        print(f"{'':12}{'clock [s]':>10}{'CPU [s]':>9}{'workers':>9}  of all rounds, by the clock")
        for way, runs in taken.items():
            least = [min(run[i] for run in runs) for i in (0, 1, 2)]
            clocks = " ".join(f"{run[0]:.1f}" for run in runs)
            same = same_events(unsplit, read_results(results[way]).events)
            note = "" if same else "  DECIDED OTHERWISE"
            print(f"{way:12}{least[0]:10.1f}{least[1]:9.1f}{least[2]:9.1f}  {clocks}{note}")
        for slow, fast in (("one worker", "two workers"), ("in one go", "two workers")):
            pairs = zip(taken[slow], taken[fast], strict=True)
            ratios = " ".join(f"{one[0] / two[0]:.2f}" for one, two in pairs)
            best = min(run[0] for run in taken[slow]) / min(run[0] for run in taken[fast])
            print(f"{slow} over {fast}: {best:.2f} of least times; by round {ratios}")
            one = min(main_s + workers for _, main_s, workers in taken[slow])
            main_s, workers = (min(run[i] for run in taken[fast]) for i in (1, 2))
            bound = one / max(main_s, (main_s + workers) / 2)
            print(f"  of processor time: {bound:.2f} at most on two cores")


if __name__ == "__main__":
    main()
