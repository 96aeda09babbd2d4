"""Files and processes: import, writing, start-up, and peak memory against length.

A simulated room of 16 channels at 20 kHz. Speeds are megabytes of 16-bit samples per second of CPU
time; start-up and peak memory are those of processes of their own. ``--hour`` adds an hour.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from replay_speed import CHANNELS, RATE_HZ, samples_of, write_miniseed
from timing import taken_s

from groundtrace.simulate import RoomOptions, simulate_room
from groundtrace_codecs.importers import import_recording
from groundtrace_codecs.writer import write_recording

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from groundtrace_codecs.signals import SignalBlock

PIECE_S = 20.0
STARTS = {
    "--help": ["--help"],
    "pipelines": ["pipelines"],
}


def repeated(piece: Sequence[SignalBlock], times: int) -> Iterator[SignalBlock]:
    """The blocks of a piece, again and again, in one run."""
    length = sum(map(len, piece))
    for turn in range(times):
        for block in piece:
            yield replace(block, first=block.first + turn * length)


def write_room(path: Path, seconds: float) -> float:
    """Write a recording; return the CPU time of writing [s]."""
    simulation = simulate_room(RoomOptions(duration_s=PIECE_S, channels=CHANNELS, rate_hz=RATE_HZ))
    ((stream, stored, blocks),) = simulation.sources
    piece = list(blocks)
    times = round(seconds / PIECE_S)
    began = time.process_time()
    source = (stream, stored, repeated(piece, times))
    write_recording(path, [source], geometry=simulation.geometry, force=True)
    return time.process_time() - began


#: Runs a command and says at its end what it took at most; what ``wait4`` says of a process began
#: with the memory of the one that started it.
CODE = """
import atexit, sys
from pathlib import Path
from groundtrace.commands import main
status = Path("/proc/self/status")
atexit.register(lambda: Path(sys.argv.pop()).write_text(status.read_text()))
main(sys.argv[1:-1])
"""


def ran(*arguments: str | Path) -> tuple[float, float]:
    """Run a command; return its CPU time [s] and peak memory [MB]."""
    with tempfile.NamedTemporaryFile("r") as told:
        command = [sys.executable, "-c", CODE, *map(str, arguments), told.name]
        with subprocess.Popen(command, stdout=subprocess.DEVNULL) as child:
            _, status, used = os.wait4(child.pid, 0)
            child.returncode = os.waitstatus_to_exitcode(status)
        if child.returncode:
            sys.exit(f"{' '.join(map(str, arguments))}: ended with {child.returncode}")
        peak = next(line for line in told if line.startswith("VmHWM"))
    return used.ru_utime + used.ru_stime, int(peak.split()[1]) / 1024


def main() -> None:
    """Print the rows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hour", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path, seed = Path(folder) / "room.mcap", Path(folder) / "room.mseed"
        took = write_room(path, 60.0)
        megabytes = 60.0 * CHANNELS * RATE_HZ * 2 / 1e6
        print(f"writing, zstd:       {megabytes / took:6.0f} MB/s")
        write_miniseed(samples_of(path), seed)
        took = taken_s(lambda: import_recording([seed], Path(folder) / "imported.mcap"))
        print(f"import of miniSEED:  {megabytes / took:6.0f} MB/s")
        for name, arguments in STARTS.items():
            print(f"groundtrace {name:9}{min(ran(*arguments)[0] for _ in range(3)):6.2f} s of CPU")
        for minutes in (1, 10, *((60,) if options.hour else ())):
            write_room(path, 60.0 * minutes)
            results = Path(folder) / "results.mcap"
            chosen = ("--pipeline", "room-steps", "--no-viewer", "--out", results, "--force")
            took, peak = ran("replay", path, *chosen)
            print(f"replay of {minutes:2} min:    {took:6.1f} s of CPU, at most {peak:4.0f} MB")


if __name__ == "__main__":
    main()
