"""A replay on one core and on two, by the clock: a room recorded for ten minutes at 20 kHz.

Each run is a process of its own, as a command is: it replays a minute to warm up, then the whole
recording. Runs on one core and on two take turns; medians of their ratios count.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from replay_speed import PowerSink, room, whole_replay, with_results
from timing import alone

CASES = {
    "replay to decisions": whole_replay,
    "replay, and 60/30 power": lambda path: whole_replay(path, PowerSink()),
    "replay, and results file": with_results,
}


def run_here(case: str, minute: Path, path: Path) -> None:
    """Print how long the clock says that a replay took, after another [s]."""
    CASES[case](minute)
    began = time.perf_counter()
    CASES[case](path)
    print(time.perf_counter() - began)


def clocked_s(case: str, cores: list[int], *paths: Path) -> float:
    """Return what :func:`run_here` prints in a process on these cores [s]."""
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, cores)
    try:
        command = [sys.executable, __file__, "--case", case, *map(str, paths)]
        return float(subprocess.run(command, check=True, capture_output=True).stdout)
    finally:
        os.sched_setaffinity(0, before)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--case", choices=CASES)
    parser.add_argument("paths", nargs="*", type=Path)
    options = parser.parse_args()
    alone()
    if options.case:
        run_here(options.case, *options.paths)
        return
    two = sorted(os.sched_getaffinity(0))[:2]
    with tempfile.TemporaryDirectory() as folder:
        minute = room(Path(folder) / "minute.mcap", 60.0)
        paths = (minute, room(Path(folder) / "room.mcap", options.seconds))
        print(f"{'by the clock, ms per s':28}{'one core':>10}{'two':>8}{'ratio':>8}  ratios")
        for case in CASES:
            pairs = [
                (clocked_s(case, two[:1], *paths), clocked_s(case, two, *paths))
                for _ in range(options.runs)
            ]
            ratios = sorted(one / both for one, both in pairs)
            one, both = (
                1e3 * statistics.median(t) / options.seconds for t in zip(*pairs, strict=True)
            )
            ratio_text = " ".join(f"{ratio:.2f}" for ratio in ratios)
            middle = statistics.median(ratios)
            print(f"{case:28}{one:10.2f}{both:8.2f}{middle:8.2f}  {ratio_text}")


if __name__ == "__main__":
    main()
