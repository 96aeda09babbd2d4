"""What the outlook of the thesis gains: paths known beforehand, and sensors near the walker alone.

    python bench/room_outlook.py [--first 241 --last 264] [--sensors 4 6 9 16]

Walks in rooms of any wave law, as of room_laws.py. The tracker of room-footsteps is given no paths;
the walker's own, each corner of which was measured wrongly by a normal law of 0.2 m; and a path of
the same form that leads elsewhere, mirrored in the room: the check must refuse it. Each localizer
takes all arrivals, or those of so many sensors nearest to the place before.

What a path may be off was chosen on seeds 101 to 112, 4 and 9 sensors, of 0.15, 0.3 and 0.6 m; the
report is on 241 to 264.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from room_laws import Errors, options_of, score
from timing import alone

from groundtrace.pipeline.config import PipelineConfig, load_pipeline
from groundtrace.simulate.recording import write
from groundtrace.simulate.room import simulate_room
from groundtrace.simulate.room_plan import paths_in

if TYPE_CHECKING:
    from groundtrace.pipeline.parameters import StageConfig
    from groundtrace_codecs.geometry import Geometry

#: How wrongly the corners of paths are measured [m].
MEASURED_M = 0.2


def outlook(sigmas_m: list[float], nearest: list[int]) -> PipelineConfig:
    """Return room-footsteps with trackers that stray by some lengths, and fewer sensors."""
    config = load_pipeline("room-footsteps")
    *stages, tracker = config.stage
    for stage in config.stage:
        if stage.use in ("so-tdoa", "hyperbolic", "power-law", "self-calibrating"):
            stages += [_with(stage, f"{stage.key} {n}", nearest=n) for n in nearest]
    stages += [_with(tracker, f"track {s:g}", path_sigma_m=s) for s in sigmas_m]
    stages = [s for s in stages if s.use != "disagreement"]
    return replace(config, stage=tuple(stages))


def _with(stage: StageConfig, name: str, **parameters: float) -> StageConfig:
    return replace(stage, name=name, parameters={**stage.parameters, **parameters})


def drawn_paths(site: Geometry, path: np.ndarray, seed: int) -> dict[str, Geometry]:
    """Return the site with the walker's path as it was measured, and with it mirrored."""
    rng = np.random.default_rng([seed, 77])
    measured = path + rng.normal(0, MEASURED_M, path.shape)
    low, high = np.min(site.outline, axis=0), np.max(site.outline, axis=0)
    sites = {}
    for name, line in (("own path", measured), ("wrong path", low + high - measured)):
        corners = tuple((float(x), float(y)) for x, y in line)
        sites[name] = replace(site, paths=(corners,))
    return sites


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=241)
    parser.add_argument("--last", type=int, default=264)
    parser.add_argument("--sensors", type=int, nargs="+", default=[4, 6, 9, 16])
    parser.add_argument("--sigmas", type=float, nargs="+", default=[0.0, 0.6], metavar="M")
    parser.add_argument("--nearest", type=int, nargs="*", default=[5, 7])
    options = parser.parse_args()
    alone()
    for sensors in options.sensors:
        tables: dict[str, Errors] = {}
        refused = dict.fromkeys(("own path", "wrong path"), 0)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "room.mcap"
            for seed in range(options.first, options.last + 1):
                plan = options_of(seed, sensors, walks=True)
                made = simulate_room(plan)
                write(made, path, force=True)
                drawn = made.metadata["simulation"]["path"]
                (line,) = paths_in(made.geometry.outline, drawn)
                for name, site in drawn_paths(made.geometry, line.points, seed).items():
                    config = outlook(
                        options.sigmas if name == "own path" else options.sigmas[1:],
                        [n for n in options.nearest if n < sensors and name == "own path"],
                    )
                    by_stage, notes = score(path, config, site)
                    refused[name] += any("paths lead" in note.text for note in notes)
                    for stage, errors in by_stage.items():
                        by = f"{stage}, {name}" if stage.startswith("track") else stage
                        if name == "own path" or by != stage:
                            total = tables.setdefault(by, Errors())
                            total += errors
        print(f"\n{sensors} sensors; paths contradicted in some fixes: {refused}")
        print("| stage | median / 95 % [m] | in 68 / 90 % | NEES | found |")
        print("| --- | --- | --- | --- | --- |")
        for name, errors in tables.items():
            print(f"| {name} | {errors.cells()} |", flush=True)


if __name__ == "__main__":
    main()
