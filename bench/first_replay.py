"""The first replay of an installation beside the second, of every shipped pipeline.

    python bench/first_replay.py                         all pipelines
    python bench/first_replay.py heading room-steps      some of them

Each replay is a process of its own, start and exit included, of a short simulated recording, by
the clock, and in brackets by its CPU time, which other work on the machine changes less. Before the
first one nothing is compiled: ``NUMBA_CACHE_DIR`` is an empty folder. Modules are in memory: a
replay with another folder goes before. What differs are the compiled functions; they are counted.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from groundtrace.pipeline.config import named_pipelines

GROUNDTRACE = str(Path(sys.executable).with_name("groundtrace"))
#: How recordings are simulated, and which pipelines replay them.
ROOM = "room --seed 7 --rate-hz 4000 --duration-s 4"
WALK = "walk --seed 7 --duration-s 20"
ROAD = "vehicle --seed 7 --layout stations --duration-s 60 --passes 2"
SIMULATED = {
    ROOM: ("room-footsteps", "room-steps", "floor-steps"),
    f"{ROOM} --walkers 2": ("room-two-walkers",),
    f"{ROOM} --channels 4 --triaxial": ("room-bearings",),
    f"{ROOM} --impacts": ("hammer-shots", "signals"),
    WALK: ("waist-steps", "waist-peaks", "waist-crossings", "waist-dstp", "waist-swing"),
    f"{WALK} --types": ("step-types", "step-types-live"),
    f"{WALK} --placement trunk --path loop": (
        "heading",
        "pedestrian",
        "pedestrian-aligned",
        "pedestrian-compass",
        "pedestrian-waypoints",
    ),
    f"{WALK} --placement foot --path l": ("foot-inertial", "foot-stances"),
    ROAD: ("vehicle-tracks", "vehicle-passes"),
}
#: The most that the first replay may take longer than the second [s].
WANTED_S = 12.0


def taken_s(folder: str, cache: str, *words: str) -> tuple[float, float]:
    """Run a command, compiled functions kept in ``cache``; return its time by the clock, of CPU."""
    inherited = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    environment = {**inherited, "NUMBA_CACHE_DIR": str(Path(folder, cache))}
    before, began = os.times(), time.perf_counter()
    subprocess.run(
        [GROUNDTRACE, *words], cwd=folder, env=environment, check=True, capture_output=True
    )
    wall_s, after = time.perf_counter() - began, os.times()
    used = (after.children_user - before.children_user, after.children_system)
    return wall_s, used[0] + used[1] - before.children_system


def compiled_in(folder: str, cache: str) -> int:
    """Return how many compiled functions are kept, one for each of its signatures."""
    return len(list(Path(folder, cache).rglob("*.nbc")))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("pipelines", nargs="*", metavar="PIPELINE")
    wanted = parser.parse_args().pipelines
    shown = [name for names in SIMULATED.values() for name in names]
    if missing := set(named_pipelines()) - set(shown):
        raise SystemExit(f"expected a recording for every pipeline, found none for {missing}")
    print(
        f"{'by the clock (CPU) [s]':24}{'first':>13}{'second':>13}{'longer':>13}{'functions':>11}"
    )
    with tempfile.TemporaryDirectory() as folder:
        for number, (how, names) in enumerate(SIMULATED.items()):
            chosen = [name for name in names if not wanted or name in wanted]
            recording = f"{number}.mcap"
            if chosen:
                taken_s(folder, "before", "simulate", *how.split(), "--out", recording)
            for name in chosen:
                words = ("replay", recording, "--pipeline", name, "--force", "--no-viewer")
                taken_s(folder, "before", *words)
                first, second = (taken_s(folder, name, *words) for _ in range(2))
                longer = (first[0] - second[0], first[1] - second[1])
                row = "".join(
                    f"{wall:7.1f}{f'({cpu:.1f})':>6}" for wall, cpu in (first, second, longer)
                )
                late = "" if longer[0] <= WANTED_S else f"  more than {WANTED_S:g} s"
                print(f"{name:24}{row}{compiled_in(folder, name):11}{late}", flush=True)


if __name__ == "__main__":
    main()
