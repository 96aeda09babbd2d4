"""Recordings with truth for a fleet: walks of a waist sensor and rooms, each of another seed.

Each is a few seconds long, so that hundreds are made in a minute; three of them are then damaged:
torn, with a page of zeros, and no recording at all.
"""

from __future__ import annotations

import argparse
from multiprocessing import get_context
from pathlib import Path

from groundtrace.simulate.gait import WalkOptions
from groundtrace.simulate.recording import write
from groundtrace.simulate.room import simulate_room
from groundtrace.simulate.room_plan import RoomOptions
from groundtrace.simulate.walk import simulate_walk

#: Every so many recordings one is a room.
ROOM_EVERY = 10


def make(job: tuple[Path, int, float]) -> None:
    """Write one recording; what it holds depends on its number alone."""
    folder, number, seconds = job
    if number % ROOM_EVERY == 0:
        snr = 3.0 + 17.0 * (number % 7) / 6
        room = RoomOptions(seed=number, duration_s=seconds, channels=4, rate_hz=4000.0, snr=snr)
        write(simulate_room(room), folder / f"room-{number:05d}.mcap", force=True)
        return
    walk = WalkOptions(seed=number, duration_s=seconds)
    write(simulate_walk(walk), folder / f"walk-{number:05d}.mcap", force=True)


def damage(folder: Path) -> None:
    """Hurt the last three walks: the first of them is torn, one has a hole, the last is junk."""
    torn, holed, junk = sorted(folder.glob("walk-*.mcap"))[-3:]
    data = torn.read_bytes()
    torn.write_bytes(data[: len(data) // 2])
    data = holed.read_bytes()
    middle = len(data) // 2
    holed.write_bytes(data[:middle] + bytes(4096) + data[middle + 4096 :])
    junk.write_bytes(b"this is no recording" * 100)


def main() -> None:
    """Make them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--sound", action="store_true", help="damage none")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    jobs = [(options.folder, number, options.seconds) for number in range(1, options.count + 1)]
    with get_context("spawn").Pool() as pool:
        for _ in pool.imap_unordered(make, jobs, chunksize=5):
            pass
    if not options.sound:
        damage(options.folder)


if __name__ == "__main__":
    main()
