"""What an hour of recording costs a fleet: processor time, and storage of all that comes of it.

    python bench/fleet_cost.py --seconds 60

Each kind of recording is simulated, taken through its pipeline as a fleet does, and replayed with
results and timeline for their sizes. Processor time does not depend on what else runs.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import resource
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from groundtrace.cli.main import main as groundtrace
from groundtrace.fleet.run import Task, evaluate, identity_of, recipes_of
from groundtrace.simulate.gait import WalkOptions
from groundtrace.simulate.recording import write
from groundtrace.simulate.road import VehicleOptions
from groundtrace.simulate.room import simulate_room
from groundtrace.simulate.room_plan import RoomOptions
from groundtrace.simulate.vehicle import simulate_vehicle
from groundtrace.simulate.walk import simulate_walk

if TYPE_CHECKING:
    from groundtrace.simulate.recording import Simulation

HOUR_S = 3600.0
CASES = {
    "IMU 100 Hz, waist-steps": ("walk", "waist-steps"),
    "IMU 100 Hz, pedestrian": ("walk", "pedestrian"),
    "room 8 ch x 20 kHz, room-footsteps": ("room", "room-footsteps"),
    "road 1 kHz, vehicle-passes": ("vehicle", "vehicle-passes"),
}


def simulated(kind: str, seconds: float) -> Simulation:
    """Return a recording of a kind."""
    if kind == "walk":
        return simulate_walk(WalkOptions(duration_s=seconds))
    if kind == "room":
        return simulate_room(RoomOptions(duration_s=seconds, channels=8, rate_hz=20_000.0))
    return simulate_vehicle(VehicleOptions(duration_s=seconds))


def command(*arguments: object) -> None:
    """Run a command quietly."""
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        groundtrace([str(argument) for argument in arguments])


def measured(folder: Path, kind: str, pipeline: str, seconds: float) -> list[float]:
    """Return processor time [s] and sizes [MB] of an hour."""
    path = folder / f"{kind}.mcap"
    if not path.is_file():
        write(simulated(kind, seconds), path)
    (recipe,) = recipes_of([pipeline], [], 0.12)
    short, task = Task(str(path), recipe), Task(str(path), recipe)
    evaluate(short)  # what is loaded and compiled once
    began = time.process_time()
    done = evaluate(task)
    taken = time.process_time() - began
    began = time.process_time()
    evaluate(replace(task, done_keys=frozenset({identity_of(task).key})))
    hash_s = time.process_time() - began
    results, rrd = folder / "r.mcap", folder / "r.rrd"
    command("replay", path, "--pipeline", pipeline, "--out", results, "--rrd", rrd, "--force")
    sizes = [p.stat().st_size for p in (path, results, rrd)]
    hours = seconds / HOUR_S
    sizes_mb = [size / 1e6 / hours for size in (*sizes, len(done.data or b""))]
    return [taken / hours, *sizes_mb, hash_s / hours]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    options = parser.parse_args()
    print(f"per recorded hour, from {options.seconds:g} s of each")
    print(
        f"{'':36}{'cpu s':>8}{'recording':>11}{'results':>9}{'.rrd':>9}{'part MB':>9}{'hash s':>8}"
    )
    for name, (kind, pipeline) in CASES.items():
        with tempfile.TemporaryDirectory() as folder:
            cpu, recording, results, rrd, part, hash_s = measured(
                Path(folder), kind, pipeline, options.seconds
            )
        print(
            f"{name:36}{cpu:8.1f}{recording:11.1f}{results:9.2f}{rrd:9.1f}{part:9.3f}{hash_s:8.2f}",
            flush=True,
        )
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    print(f"peak memory {peak:.0f} MB, {sys.version.split()[0]}")


if __name__ == "__main__":
    main()
