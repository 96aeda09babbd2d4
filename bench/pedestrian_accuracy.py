"""Tracks of real and simulated walkers through named pipelines: the table of pedestrian.md.

    python bench/pedestrian_accuracy.py --data FOLDER

The folder holds ``indoor-location-20`` as published. Nothing is set but the name of the pipeline.
Beside each error stands the part of the true places that lie within the claimed ellipse of 90 %.
Simulated people with odd numbers chose the constant of step lengths; the even ones were seen.

These traces were seen while the tracker was made; the first, third, ... chose what
``pedestrian-waypoints`` takes single steps for, and the others have a line of their own
(docs/accuracy.md).
"""

from __future__ import annotations

import argparse
import os
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from groundtrace.api.calibration import lengths_of
from groundtrace.evaluation.positions import score_closure, score_waypoints, true_places
from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import load_pipeline
from groundtrace.pipeline.engine import EventList, replay
from groundtrace.pipeline.source import Source
from groundtrace.simulate.gait import WalkOptions
from groundtrace.simulate.recording import Simulation, write
from groundtrace.simulate.walk import simulate_walk
from groundtrace_codecs.events import CandidateBlock, TrackPoint
from groundtrace_codecs.importers.run import import_recording
from groundtrace_codecs.recording import Recording

PIPELINES = ("pedestrian", "pedestrian-aligned", "pedestrian-compass")
STAGES = ("track", "track.smoothed")
LOOP_M = 260.0
#: How long people walk to calibrate their steps: 80 to 320 m.
CALIBRATE_S = 200.0
#: Seed of the loop whose sensor is turned about the vertical, and by how much.
TURNED_SEED, TURNED_DEG = 2, (90.0, 180.0, -130.0)


class Points:
    """A sink that keeps the points of tracks, by stage."""

    def __init__(self) -> None:
        self.of: dict[str, list[TrackPoint]] = {stage: [] for stage in STAGES}

    def write(self, item: object) -> None:
        if isinstance(item, TrackPoint):
            self.of[item.stage].append(item)


def tracks(opened: Recording, pipeline: str, labels: tuple = ()) -> dict[str, list[TrackPoint]]:
    """Return the points that a named pipeline gives, by stage; ``labels`` are what it may know."""
    sink = Points()
    chain = build_pipeline(load_pipeline(pipeline), opened.geometry, labels)
    replay(tuple(Source(opened)), chain, [sink])
    return sink.of


#: Normalised square that 90 % of errors in a plane stay below.
CHI2_90 = 4.605


def claims(points: list[TrackPoint], labels: tuple) -> tuple[np.ndarray, np.ndarray]:
    """Return how far true places are from a track and its covariances there, by those it passes.

    Shape (n, 2) [m] and (n, 2, 2) [m2].
    """
    since = np.array([p.time_ns for p in points], float)
    values = np.array([(p.x_m, p.y_m, *p.covariance) for p in points])
    scored = [x for x in labels if since[0] <= x.time_ns <= since[-1]]
    times_ns = [x.time_ns for x in scored]
    x, y, xx, xy, yy = (np.interp(times_ns, since, column) for column in values.T)
    true = np.array([(k.x_m, k.y_m) for k in scored], float).reshape(-1, 2)
    spread = np.array([[xx, xy], [xy, yy]]).transpose(2, 0, 1)
    return true - np.stack([x, y], axis=1), spread + 1e-6 * np.eye(2)


def squares(off: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """Return normalised squares of errors, shape (n,)."""
    return np.einsum("ni,ni->n", off, np.linalg.solve(spread, off[..., None])[..., 0])


def inside(points: list[TrackPoint], labels: tuple, own_m: float = 0.0) -> float:
    """Return the part of true places within the claimed ellipse of 90 % at their time.

    ``own_m`` is the standard deviation of the places themselves.
    """
    off, spread = claims(points, labels)
    within = squares(off, spread + own_m**2 * np.eye(2)) <= CHI2_90
    return int(within.sum()) / max(len(within), 1)


def people(count: int) -> None:
    """Way of simulated people by default and calibrated on another walk, and places inside."""
    print("waist, simulated people on the loop: way told of 260 m by default, and calibrated [%]")
    rows = []
    for number in range(1, count + 1):
        with tempfile.TemporaryDirectory() as scratch:
            short, loop = Path(scratch) / "short.mcap", Path(scratch) / "loop.mcap"
            calibration = WalkOptions(
                path="loop", seed=700 + number, person=number, duration_s=CALIBRATE_S
            )
            write(simulate_walk(calibration), short)
            write(simulate_walk(WalkOptions(path="epfl", seed=number, person=number)), loop)
            with Recording.open(loop) as opened:
                by_default = walked(opened, {})
                if by_default < LOOP_M / 2:
                    print(f"  person {number}: hardly any steps found", flush=True)
                    continue
                points = tracks(opened, "pedestrian")["track.smoothed"]
                inside_part = inside(points, tuple(x for x in opened.labels if x.kind == "step"))
                constants = lengths_of(short, way_m(short))[1].models[-1].constants
                both = [100 * (m / LOOP_M - 1) for m in (by_default, walked(opened, constants))]
        rows.append((number, *both, inside_part))
        print(
            f"  person {number}: {both[0]:+.1f} {both[1]:+.1f}, {inside_part:.2f} inside",
            flush=True,
        )
    for name, part in (("odd, chosen on", 1), ("even, seen", 0)):
        figures = np.array([row[1:] for row in rows if row[0] % 2 == part])
        mean, size = figures.mean(axis=0), np.abs(figures).mean(axis=0)
        print(
            f"  {name}: mean {mean[0]:+.1f}, mean size {size[0]:.1f}, calibrated {size[1]:.2f} "
            f"(largest {np.abs(figures[:, 1]).max():.1f}), inside {mean[2]:.2f}"
        )


def way_m(path: Path) -> float:
    """Return the true way of a simulated walk, by the places told ten times a second."""
    with Recording.open(path) as opened:
        places = np.array([x.x_m + 1j * x.y_m for x in opened.labels if x.kind == "heading"])
    return float(np.abs(np.diff(places)).sum())


def walked(opened: Recording, constants: dict[str, float]) -> float:
    """Return the sum of the lengths of steps [m]."""
    config = load_pipeline("pedestrian")
    stages = tuple(
        replace(s, parameters={**s.parameters, **constants}) if s.name == "track" else s
        for s in config.stage
    )
    sink = EventList()
    chain = build_pipeline(replace(config, stage=stages), opened.geometry)
    replay(tuple(Source(opened)), chain, [sink])
    blocks = [x for x in sink.events if isinstance(x, CandidateBlock)]
    at = [[c.name for c in x.spec.columns] for x in blocks]
    return float(
        sum(
            x.value[x.accepted, names.index("length")].sum()
            for x, names in zip(blocks, at, strict=True)
            if "length" in names
        )
    )


def indoors(folder: Path) -> None:
    """Median waypoint errors of every trace; the waypoints' own pipeline at those left out."""
    medians: dict[tuple[str, str], list[float]] = {}
    inside_parts: dict[tuple[str, str], list[float]] = {}
    noisy: dict[str, list[float]] = {}
    waypoint_m = load_pipeline("pedestrian-waypoints").stage[-1].parameters["waypoint_m"]
    for path in sorted(folder.glob("*/*/path_data_files/*.txt")):
        with tempfile.TemporaryDirectory() as scratch:
            out = Path(scratch) / "trace.mcap"
            import_recording([path], out)
            with Recording.open(out) as opened:
                way = tuple(x for x in opened.labels if x.kind == "waypoint")
                cases = [(name, way, way) for name in PIPELINES]
                cases.append(("pedestrian-waypoints", way[::2], way[1::2]))
                for name, anchors, scored in cases:
                    for stage, points in tracks(opened, name, anchors).items():
                        score = score_waypoints(
                            (way[0], *scored) if anchors != way else way, points
                        )
                        if score is not None:
                            medians.setdefault((name, stage), []).append(score.median_m)
                            unknown = scored[2:] if name == "pedestrian-aligned" else scored[1:]
                            inside_parts.setdefault((name, stage), []).append(
                                inside(points, unknown)
                            )
                            if name == "pedestrian-waypoints":
                                part = inside(points, unknown, waypoint_m)
                                noisy.setdefault(stage, []).append(part)
    print("phone in hand (indoor-location-20): median waypoint error [m], places inside, each")
    for (name, stage), each in medians.items():
        listed = " ".join(f"{x:.1f}" for x in each)
        part = np.mean(inside_parts[name, stage])
        print(f"  {name:20} {stage:14} {np.median(each):5.2f}  {part:.2f}  ({listed})")
        if name == "pedestrian-waypoints":
            rest = [np.mean(parts[1::2]) for parts in (inside_parts[name, stage], noisy[stage])]
            print(
                f"    of those not chosen on   {np.median(each[1::2]):5.2f}  {rest[0]:.2f}, "
                f"{rest[1]:.2f} with the waypoints' own {waypoint_m:g} m"
            )
    print("  pedestrian-waypoints: every second waypoint known, the others scored")


def loops(seeds: range) -> None:
    """End errors of the simulated loop with disturbances on its second straight."""
    print(f"waist (simulated loop of {LOOP_M:g} m, disturbed): end off, part of the way")
    for seed in seeds:
        with tempfile.TemporaryDirectory() as scratch:
            out = Path(scratch) / "loop.mcap"
            write(simulate_walk(WalkOptions(path="epfl", seed=seed)), out)
            with Recording.open(out) as opened:
                texts = []
                for name in ("pedestrian", "pedestrian-compass"):
                    points = tracks(opened, name)["track"]
                    closure = score_closure(true_places(opened.labels), points)
                    if closure is not None:
                        off = abs(closure.apart_m - closure.true_apart_m)
                        part = 100 * off / LOOP_M
                        walked = closure.walked_m
                        texts.append(f"{name} {off:.2f} m {part:.2f} % (track {walked:.0f} m)")
                print(f"  seed {seed}: {', '.join(texts)}")


def turned(simulation: Simulation, angle_deg: float) -> Simulation:
    """Return the same walk with the sensor turned about its upper axis, counter-clockwise."""
    mount = Rotation.from_euler("Z", angle_deg, degrees=True).inv()
    sources = []
    for stream, form, blocks in simulation.sources:
        axes = range(0, len(stream.channels) if stream.channels[0].axis else 0, 3)
        moved = [
            replace(b, samples=np.hstack([mount.apply(b.values[:, k : k + 3]) for k in axes]))
            if axes
            else b
            for b in blocks
        ]
        sources.append((stream, form, moved))
    return replace(simulation, sources=sources)


def turned_loops() -> None:
    """End errors of one of the loops, the sensor turned further."""
    print(f"waist, seed {TURNED_SEED}, sensor turned further: end off, part of the way")
    for angle_deg in TURNED_DEG:
        with tempfile.TemporaryDirectory() as scratch:
            out = Path(scratch) / "loop.mcap"
            walk = simulate_walk(WalkOptions(path="epfl", seed=TURNED_SEED))
            write(turned(walk, angle_deg), out)
            with Recording.open(out) as opened:
                points = tracks(opened, "pedestrian")["track"]
                closure = score_closure(true_places(opened.labels), points)
            if closure is not None:
                off = abs(closure.apart_m - closure.true_apart_m)
                print(f"  {angle_deg:g} degrees: {off:.2f} m {100 * off / LOOP_M:.2f} %")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--data", type=Path, default=Path(os.environ.get("GROUNDTRACE_DATA", "../shared/data"))
    )
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--people", type=int, default=40)
    options = parser.parse_args()
    indoors(options.data / "indoor-location-20")
    people(options.people)
    loops(range(1, options.seeds + 1))
    turned_loops()


if __name__ == "__main__":
    main()
