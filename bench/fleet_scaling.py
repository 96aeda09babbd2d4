"""A fleet computed in several ways: that all give one table, and what each takes, as ratios.

The ways: local processes, one and two of them; two of which some are killed (SIGKILL), interrupted
(SIGINT) and resumed; a Dask cluster started for the run; three shards, joined. Needs Linux.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Sequence

COMMAND = (sys.executable, "-c", "from groundtrace.cli.main import main; main()", "fleet")
#: How many workers are killed before the run is interrupted, half way.
KILLS = 6


def fleet(folder: Path, table: Path, *options: str) -> tuple[dict[str, Any], float]:
    """Run a fleet; return its report and the wall time [s]."""
    began = time.perf_counter()
    ran = subprocess.run(
        [*COMMAND, str(folder), "-o", str(table), "--json", *options],
        check=True,
        stdout=subprocess.PIPE,
    )
    return json.loads(ran.stdout), time.perf_counter() - began


def children(pid: int) -> list[int]:
    """Return the processes that a process started."""
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def killed_and_resumed(folder: Path, table: Path) -> tuple[dict[str, Any], float, list[str]]:
    """Kill workers, interrupt, resume; return the report, the time, and what was said."""
    began, killed = time.perf_counter(), 0
    command = [*COMMAND, str(folder), "-o", str(table), "--workers", "2"]
    # a shell that starts this in the background would leave what it starts deaf to SIGINT
    previous_handler = signal.signal(signal.SIGINT, signal.SIG_DFL)
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as running:
        signal.signal(signal.SIGINT, previous_handler)
        half = len(list(folder.glob("*.mcap"))) // 2
        for number in range(1, KILLS + 1):
            wait_for(table.with_suffix(".parts"), number * half // (KILLS + 1), running)
            workers = [c for c in children(running.pid) if b"spawn_main" in _line(c)]
            if workers:
                os.kill(workers[number % len(workers)], signal.SIGKILL)
                killed += 1
        wait_for(table.with_suffix(".parts"), half, running)
        running.send_signal(signal.SIGINT)
        _, errors = running.communicate()
    part_count = len(list(table.with_suffix(".parts").iterdir()))
    code = running.returncode
    lines = [
        f"{killed} workers killed; interrupted: exit code {code}, {part_count} parts kept",
        errors,
    ]
    report, _ = fleet(folder, table, "--workers", "2", "--resume")
    return report, time.perf_counter() - began, lines


def wait_for(parts: Path, count: int, running: subprocess.Popen[str]) -> None:
    """Wait until so many parts are there, or the run has ended."""
    while running.poll() is None and sum(1 for _ in parts.glob("[!.]*")) < count:
        time.sleep(0.05)


def _line(pid: int) -> bytes:
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return b""


def sharded(folder: Path, table: Path) -> tuple[dict[str, Any], float]:
    """Compute three shards, two of them at once, and join them."""
    began = time.perf_counter()
    command = [*COMMAND, str(folder), "-o", str(table), "--workers", "1", "--shard"]
    first = [subprocess.Popen([*command, f"{i}/3"], stdout=subprocess.DEVNULL) for i in (1, 2)]
    if any(process.wait() for process in first):
        raise SystemExit("a shard failed")
    subprocess.run([*command, "3/3"], check=True, stdout=subprocess.DEVNULL)
    report, _ = fleet(folder, table, "--join")
    return report, time.perf_counter() - began


def show(rows: Sequence[tuple[str, dict[str, Any], float, float]]) -> None:
    """Print what each way took, against the first, and whether all decided the same."""
    print(
        f"{'':10}{'wall s':>8}{'ratio':>7}{'cpu s':>8}{'ratio':>7}{'rows':>6}{'errors':>8}  decided"
    )
    for name, report, wall_s, cpu_s in rows:
        ratios = wall_s / rows[0][2], cpu_s / rows[0][3]
        times = f"{wall_s:8.1f}{ratios[0]:7.2f}{cpu_s:8.1f}{ratios[1]:7.2f}"
        counts = f"{report['rows']:6}{report['errors']:8}"
        print(f"{name:10}{times}{counts}  {(report['digest'] or '')[:16]}")
    digests = {report["digest"] for _, report, _, _ in rows}
    print("all decided the same" if len(digests) == 1 else f"{len(digests)} DIFFERENT TABLES")


def cpu_s() -> float:
    """Return the processor time of all that was run and has ended, with what it started [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main() -> None:
    """Compute a fleet in every way."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="recordings, as fleet_recordings.py makes them")
    parser.add_argument("--ways", default="local2,local1,killed,dask,shards,known")
    options = parser.parse_args()
    folder, rows = options.folder, []
    with tempfile.TemporaryDirectory() as work:
        for way in options.ways.split(","):
            table, lines, before = Path(work) / f"{way}.parquet", [], cpu_s()
            if way == "killed":
                report, wall_s, lines = killed_and_resumed(folder, table)
            elif way == "shards":
                report, wall_s = sharded(folder, table)
            elif way == "known":
                first = Path(work) / f"{rows[0][0]}.parquet"
                report, wall_s = fleet(folder, first, "--resume")
            elif way == "dask":
                report, wall_s = fleet(folder, table, "--engine", "dask", "--workers", "2")
            else:
                workers = way.removeprefix("local")
                report, wall_s = fleet(folder, table, "--workers", workers)
            rows.append((way, report, wall_s, cpu_s() - before))
            print("\n".join([f"{way}: {wall_s:.1f} s", *lines]), flush=True)
    show(rows)


if __name__ == "__main__":
    main()
