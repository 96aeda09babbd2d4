"""Peak memory and time of every command that reads a recording: docs/notebook/memory.md.

Run: python bench/big_memory.py [--minutes 1 10 60] [--folder FOLDER]
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

MAIN = "from groundtrace.cli.main import main; main()"
#: What is run on R, a recording, and S, its results; X is thrown away.
COMMANDS = {
    "`info`": "info R",
    "`doctor`": "doctor R",
    "`replay --no-viewer`": "replay R --no-viewer --out S",
    "`score`": "score S",
    "`why`": "why S",
    "`export` steps as CSV": "export S -o X.csv --kind steps",
    "`cut`": "cut R -o X.mcap --from 1",
    "`convert`": "convert R -o X.mcap --compression lz4",
    "`doctor --repair`": "doctor R --repair X.mcap",
}


def peak(command: list[str]) -> tuple[float, float]:
    """Run a command; return its peak memory [MB] and its time [s]."""
    began = time.perf_counter()
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as ran:
        _, status, used = os.wait4(ran.pid, 0)
        ran.returncode = os.waitstatus_to_exitcode(status)
    if ran.returncode:
        sys.exit(f"{' '.join(command)} ended with {ran.returncode}")
    return used.ru_maxrss / 1024, time.perf_counter() - began


def measured(minutes: int, folder: Path) -> list[str]:
    """Return the cells of one length, in the order of COMMANDS."""
    names = {"R": folder / f"{minutes}.mcap", "S": folder / f"{minutes}.results.mcap"}
    # in a process of its own: a child's peak is never below what its parent held
    big = Path(__file__).with_name("big_recording.py")
    made = [sys.executable, str(big), str(names["R"]), "--minutes", str(minutes)]
    subprocess.run(made, check=True, stdout=subprocess.DEVNULL)
    cells = []
    for text in COMMANDS.values():
        words = [str(names.get(w, w.replace("X", str(folder / "x")))) for w in text.split()]
        mb, seconds = peak([sys.executable, "-c", MAIN, *words])
        cells.append(f"{mb:.0f} MB, {seconds:.0f} s")
        for thrown_away in folder.glob("x.*"):
            thrown_away.unlink()
    names["R"].unlink()
    return cells


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=int, nargs="+", default=[1, 10, 60])
    parser.add_argument("--folder", type=Path, help="for 3 GB; a temporary one without it")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=given.folder) as folder:
        columns = [measured(minutes, Path(folder)) for minutes in given.minutes]
    print(f"| | {' | '.join(f'{m} minutes' for m in given.minutes)} |")
    print("|---|" + "---|" * len(columns))
    for row in zip(COMMANDS, *columns, strict=True):
        print(f"| {' | '.join(row)} |")


if __name__ == "__main__":
    main()
