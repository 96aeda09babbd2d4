"""Whole replay of a 16-channel, 20 kHz recording, as a ratio to sosfilt on the same samples.

Both are timed in turn, in one process, several times; the medians are compared. A ratio above 1
means that the replay, from a compressed file to decisions, is faster than one band-pass.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy import signal

from groundtrace.engine import replay
from groundtrace.pipeline import build_pipeline, load_pipeline
from groundtrace.results import Provenance, ResultsSink
from groundtrace.simulate import RoomOptions, simulate_room, write
from groundtrace.sinks import Session, Sink
from groundtrace.source import Source
from groundtrace_codecs.recording import Recording

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

CHANNELS = 16
RATE_HZ = 20_000.0
BLOCK = 2000


def blocks(path: Path) -> Iterator[np.ndarray]:
    """Samples of the recording, (channels, BLOCK) float64, for the peer."""
    with Recording.open(path) as recording:
        samples = np.concatenate([item.samples.T for item in Source(recording)], axis=1)  # type: ignore[union-attr]
    for start in range(0, samples.shape[1] - BLOCK + 1, BLOCK):
        yield samples[:, start : start + BLOCK].astype(np.float64)


def sosfilt_only(parts: list[np.ndarray]) -> None:
    """The peer: an order-4 band-pass in blocks of 2000 samples."""
    sos = signal.butter(4, [20, 2000], "bandpass", fs=RATE_HZ, output="sos")
    zi = np.zeros((len(sos), CHANNELS, 2))
    for part in parts:
        _, zi = signal.sosfilt(sos, part, axis=1, zi=zi)


def decompress_only(path: Path) -> None:
    """Reading alone: every block of the recording, decoded."""
    with Recording.open(path) as recording:
        for _ in recording.blocks():
            pass


def whole_replay(path: Path, results: Path | None = None) -> None:
    """From the compressed file to decisions with evidence."""
    with Recording.open(path) as recording:
        chain = build_pipeline(load_pipeline("room-footsteps"), recording.geometry)
        sinks: list[Sink] = []
        if results is not None:
            origin = Provenance(path.name, "", recording.start_ns, recording.end_ns, "")
            sinks.append(ResultsSink(results, origin, force=True))
        session = Session(
            path.name,
            "room",
            recording.start_ns,
            recording.end_ns,
            recording.streams,
            recording.geometry,
            recording.labels,
            "",
        )
        for sink in sinks:
            sink.open(session)
        replay(Source(recording), chain, sinks)
        for sink in sinks:
            sink.close()


def interleaved(cases: dict[str, Callable[[], None]], runs: int) -> dict[str, list[float]]:
    """Run the cases in turn, so that a drift of the machine's speed meets all of them."""
    times: dict[str, list[float]] = {name: [] for name in cases}
    for case in cases.values():
        case()
    for _ in range(runs):
        for name, case in cases.items():
            began = time.process_time()
            case()
            times[name].append(time.process_time() - began)
    return times


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--runs", type=int, default=5)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "room.mcap"
        room = RoomOptions(duration_s=options.seconds, channels=CHANNELS, rate_hz=RATE_HZ)
        write(simulate_room(room), path)
        parts = list(blocks(path))
        cases = {
            "sosfilt, blocks of 2000": lambda: sosfilt_only(parts),
            "reading alone": lambda: decompress_only(path),
            "replay to decisions": lambda: whole_replay(path),
            "replay with results file": lambda: whole_replay(path, Path(folder) / "r.mcap"),
        }
        times = interleaved(cases, options.runs)
    peer = statistics.median(times["sosfilt, blocks of 2000"])
    print(f"{CHANNELS} channels x {RATE_HZ:g} Hz, {options.seconds:g} s, one core, CPU time")
    print(f"{'':26}{'recorded s per s':>18}{'times sosfilt':>15}")
    for name, taken in times.items():
        middle = statistics.median(taken)
        print(f"{name:26}{options.seconds / middle:18.0f}{peer / middle:15.2f}")


if __name__ == "__main__":
    main()
