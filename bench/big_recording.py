"""A recording of any length: a simulated walk through a room, again and again, as floats.

Sixty seconds of nine sensors at 20 kHz are simulated once and repeated with fresh noise below one
count, so that the samples do not compress away: an hour is about 2 GB. Truth is repeated too.
`--channels 16` has more sensors: an hour is 4.4 GB.

Run: python bench/big_recording.py OUT.mcap --minutes 60
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from groundtrace.simulate.room import simulate_room
from groundtrace.simulate.room_plan import RoomOptions
from groundtrace_codecs.signals import NS_PER_S
from groundtrace_codecs.writer import write_recording

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from groundtrace_codecs.events import Label
    from groundtrace_codecs.signals import SignalBlock

PIECE_S = 60
#: Standard deviation of the noise that is added [counts].
NOISE = 0.3


@dataclass(frozen=True, slots=True)
class Repeated:
    """The blocks of a piece, again and again, in one run."""

    piece: Sequence[SignalBlock]
    times: int

    def __iter__(self) -> Iterator[SignalBlock]:
        noise = np.random.default_rng(1)
        length = sum(map(len, self.piece))
        for turn in range(self.times):
            for block in self.piece:
                samples = block.samples.astype(np.float32)
                samples += np.float32(NOISE) * noise.standard_normal(samples.shape, np.float32)
                yield replace(block, first=block.first + turn * length, samples=samples)


def repeated_labels(labels: Sequence[Label], times: int) -> list[Label]:
    """The truth of every repetition."""
    repeated = []
    for turn in range(times):
        later = turn * PIECE_S * NS_PER_S
        for label in labels:
            end_ns = None if label.end_ns is None else label.end_ns + later
            repeated.append(replace(label, time_ns=label.time_ns + later, end_ns=end_ns))
    return repeated


def write_big(path: Path, minutes: int, channels: int | None = None) -> None:
    """Write a recording of this many minutes; ``channels`` is how many sensors, None: nine."""
    simulation = simulate_room(RoomOptions(duration_s=float(PIECE_S), seed=7, channels=channels))
    ((stream, _, blocks),) = simulation.sources
    write_recording(
        path,
        [(stream, "f32le", Repeated(list(blocks), minutes))],
        geometry=simulation.geometry,
        labels=repeated_labels(simulation.labels, minutes),
        force=True,
    )


def main() -> None:
    """Write the recording that is asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--minutes", type=int, default=60)
    parser.add_argument("--channels", type=int)
    given = parser.parse_args()
    write_big(given.out, given.minutes, given.channels)
    print(f"{given.out}: {given.minutes} minutes, {given.out.stat().st_size / 1e9:.2f} GB")


if __name__ == "__main__":
    main()
