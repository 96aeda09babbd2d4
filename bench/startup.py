"""How long commands take to begin, beside importing numpy and scipy.signal, and what they load.

    python bench/startup.py              the table, then what a replay of one second loads
    python bench/startup.py --runs 15    more runs of each

Every run is a process of its own, the commands in turn; minima count, so that what else the machine
does counts less. Modules and kernels are compiled and in memory: each command runs once before.
``-X importtime`` tells what a module takes to load by itself, what it imports left out.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from groundtrace_recordings import path_of

GROUNDTRACE = str(Path(sys.executable).with_name("groundtrace"))
REPLAY = ("replay", "--to", "1", "--force", "--quiet", "--out", "startup.results.mcap")
#: What commands are held against.
REFERENCE = "import numpy, scipy.signal"
#: What a replay cannot do without: before its first function runs, numba loads the last of these,
#: and that scipy.linalg.
PARTS = ("import numpy", "import numba", "import numba.np.arraymath")
#: The most that is wanted of each command [s].
WANTED = {
    (*REPLAY, "--no-viewer"): 1.0,
    (*REPLAY, "--rrd", "startup.rrd"): 1.4,
    ("info", str(path_of("room-walk.mcap"))): 0.35,
    ("--help",): 0.2,
    ("pipelines",): 0.2,
    ("import", "--help"): 0.25,
    ("export", "--help"): 0.25,
    ("cut", "--help"): 0.25,
    ("fleet", "--help"): 0.25,
    ("score", "--help"): 0.25,
    ("sweep", "--help"): 0.25,
    ("why", "--help"): 0.25,
}
#: Rows of each table of what is loaded.
SHOWN = 12


def environment() -> dict[str, str]:
    """Return the environment of a run: Python may keep what it compiles, as it does by default."""
    return {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}


def taken_s(command: list[str], folder: str) -> tuple[float, float]:
    """Run a process; return its CPU time and its time by the clock [s]."""
    began = time.perf_counter()
    with subprocess.Popen(
        command,
        cwd=folder,
        env=environment(),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    ) as ran:
        _, status, used = os.wait4(ran.pid, 0)
        wall_s = time.perf_counter() - began
        ran.returncode = os.waitstatus_to_exitcode(status)
    if ran.returncode:
        raise SystemExit(f"{' '.join(command)}: ended with {ran.returncode}")
    return used.ru_utime + used.ru_stime, wall_s


def table(runs: int, folder: str) -> None:
    """Print what commands take, the least of some runs."""
    codes = {code: [sys.executable, "-c", code] for code in (REFERENCE, *PARTS)}
    named = {_name(words): [GROUNDTRACE, *words] for words in WANTED}
    wanted = {_name(words): limit for words, limit in WANTED.items()}
    commands = codes | named
    least: dict[str, tuple[float, float]] = {}
    for run in range(runs + 1):
        for name, command in commands.items():
            cpu_s, wall_s = taken_s(command, folder)
            if run:
                before = least.get(name, (cpu_s, wall_s))
                least[name] = min(cpu_s, before[0]), min(wall_s, before[1])
    print("| command | CPU [s] | clock [s] | wanted [s] | x scipy.signal |")
    print("|---|---:|---:|---:|---:|")
    for name, (cpu_s, wall_s) in least.items():
        limit = f"{wanted[name]:.2f}" if name in wanted else ""
        ratio = cpu_s / least[REFERENCE][0]
        print(f"| `{name}` | {cpu_s:.2f} | {wall_s:.2f} | {limit} | {ratio:.2f} |")


def _name(words: tuple[str, ...]) -> str:
    if words[0] == "replay":
        return "replay --to 1" + (" --rrd" if "--rrd" in words else "")
    return " ".join(Path(word).name for word in words)


def profile(runs: int, folder: str) -> None:
    """Print what a replay of one second loads: packages, and the modules that take longest."""
    command = [sys.executable, "-X", "importtime", GROUNDTRACE, *REPLAY, "--no-viewer"]
    least_us: dict[str, int] = {}
    for _ in range(runs):
        ran = subprocess.run(
            command, cwd=folder, env=environment(), capture_output=True, text=True, check=True
        )
        for line in ran.stderr.splitlines():
            times, _, name = line.removeprefix("import time:").rpartition("|")
            own_us = times.partition("|")[0].strip()
            if own_us.isdecimal():
                name = name.strip()
                least_us[name] = min(int(own_us), least_us.get(name, int(own_us)))
    packages: Counter[str] = Counter()
    modules: Counter[str] = Counter()
    for name, own_us in least_us.items():
        package = name.partition(".")[0]
        package = package if package not in sys.stdlib_module_names else "Python's own"
        packages[package] += own_us
        modules[package] += 1
    total_ms = sum(least_us.values()) / 1e3
    print(f"\nA replay of 1 s loads {len(least_us)} modules in {total_ms:.0f} ms:\n")
    print("| package | modules | ms |")
    print("|---|---:|---:|")
    for name, own_us in packages.most_common(SHOWN):
        print(f"| {name} | {modules[name]} | {own_us / 1e3:.0f} |")
    print("\n| module | ms |")
    print("|---|---:|")
    for name, own_us in Counter(least_us).most_common(SHOWN):
        print(f"| {name} | {own_us / 1e3:.1f} |")


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--runs", type=int, default=7)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        table(options.runs, folder)
        profile(options.runs, folder)


if __name__ == "__main__":
    main()
