"""Files and processes: writing, import, start-up, and peak memory against length.

A simulated room of 16 channels at 20 kHz. Speeds are megabytes of 16-bit samples per second of CPU
time, each row beside a peer that is timed in turn with it: zstd of the same samples alone, ObsPy
reading the same miniSEED. Start-up and peak memory, of a replay and of explaining its results, are
those of processes of their own. ``--minutes 1 10 60`` adds an hour: 5 GB of disk.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import zstandard
from replay_speed import CHANNELS, RATE_HZ, samples_of, write_miniseed
from timing import alone, interleaved

from groundtrace.simulate.room import simulate_room
from groundtrace.simulate.room_plan import RoomOptions
from groundtrace_codecs.importers.run import import_recording
from groundtrace_codecs.signals import NS_PER_S
from groundtrace_codecs.writer import write_recording

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    import numpy as np

    from groundtrace.simulate.recording import Simulation
    from groundtrace_codecs.signals import SignalBlock

PIECE_S = 20
CHUNK = 1 << 20
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


def write_room(path: Path, simulation: Simulation, seconds: float) -> None:
    """Write a recording, a piece again and again, and its true steps."""
    ((stream, stored, piece),) = simulation.sources
    times = round(seconds / PIECE_S)
    steps = [x for x in simulation.labels if x.kind == "step"]
    labels = [
        replace(x, time_ns=x.time_ns + turn * PIECE_S * NS_PER_S, end_ns=None)
        for turn in range(times)
        for x in steps
    ]
    source = (stream, stored, repeated(list(piece), times))
    write_recording(path, [source], geometry=simulation.geometry, labels=labels, force=True)


def compress(samples: np.ndarray) -> None:
    """The peer of writing: the samples alone."""
    packer, stored = zstandard.ZstdCompressor(), samples.tobytes()
    for start in range(0, len(stored), CHUNK):
        packer.compress(stored[start : start + CHUNK])


def read_miniseed(path: Path) -> None:
    """The peer of import."""
    from obspy import read

    read(path)


#: Runs a command and says at its end what it took at most; what ``wait4`` says of a process began
#: with the memory of the one that started it.
CODE = """
import atexit, sys
from pathlib import Path
from groundtrace.cli.main import main
status = Path("/proc/self/status")
atexit.register(lambda: Path(sys.argv.pop()).write_text(status.read_text()))
main(sys.argv[1:-1])
"""


def ran(*arguments: str | Path) -> tuple[float, float]:
    """Run a command; return its CPU time [s] and peak memory [MB]."""
    with tempfile.NamedTemporaryFile("r") as status_file:
        command = [sys.executable, "-c", CODE, *map(str, arguments), status_file.name]
        with subprocess.Popen(command, stdout=subprocess.DEVNULL) as child:
            _, status, used = os.wait4(child.pid, 0)
            child.returncode = os.waitstatus_to_exitcode(status)
        if child.returncode:
            sys.exit(f"{' '.join(map(str, arguments))}: ended with {child.returncode}")
        peak = next(line for line in status_file if line.startswith("VmHWM"))
    return used.ru_utime + used.ru_stime, int(peak.split()[1]) / 1024


def print_speeds(folder: Path, simulation: Simulation, runs: int) -> None:
    """Writing and import, each beside its peer."""
    seconds = 3 * PIECE_S
    path, seed = folder / "room.mcap", folder / "room.mseed"
    write_room(path, simulation, seconds)
    samples = samples_of(path)
    write_miniseed(samples, seed)
    cases = {
        "zstd of the samples alone": lambda: compress(samples.T),
        "writing, zstd": lambda: write_room(path, simulation, seconds),
        "ObsPy reads miniSEED": lambda: read_miniseed(seed),
        "import of miniSEED": lambda: import_recording(
            [seed], folder / "imported.mcap", force=True
        ),
    }
    took = list(interleaved(cases, runs).items())
    for (_, peer), (name, ours) in zip(took[::2], took[1::2], strict=True):
        rate = 2 * samples.size / 1e6 / ours
        print(f"{name:20}{rate:6.0f} MB/s, in {ours / peer:.1f} times the time of its peer")


def print_lengths(folder: Path, simulation: Simulation, minutes: Sequence[int]) -> None:
    """CPU time and peak memory of a replay and of why, by length."""
    path, results = folder / "room.mcap", folder / "results.mcap"
    for length in minutes:
        write_room(path, simulation, 60.0 * length)
        chosen = ("--pipeline", "room-steps", "--no-viewer", "--out", results, "--force")
        for name, took, peak in (
            ("replay", *ran("replay", path, *chosen)),
            ("why", *ran("why", results)),
        ):
            print(f"{name:7} of {length:2} min: {took:6.1f} s of CPU, at most {peak:4.0f} MB")


def main() -> None:
    """Print the rows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=int, nargs="+", default=[1, 10])
    parser.add_argument("--runs", type=int, default=3)
    options = parser.parse_args()
    alone()
    made = simulate_room(RoomOptions(duration_s=PIECE_S, channels=CHANNELS, rate_hz=RATE_HZ))
    stream, stored, blocks = made.sources[0]
    simulation = replace(made, sources=((stream, stored, list(blocks)),))
    with tempfile.TemporaryDirectory() as folder:
        print_speeds(Path(folder), simulation, options.runs)
        for name, arguments in STARTS.items():
            print(f"groundtrace {name:9}{min(ran(*arguments)[0] for _ in range(3)):6.2f} s of CPU")
        print_lengths(Path(folder), simulation, options.minutes)


if __name__ == "__main__":
    main()
