"""What lost packets of a recorder do to steps in rooms, vehicles, walkers and headings.

    python bench/lost_packets.py [--seeds 5 6] [--data FOLDER] [--walks FOLDER] [--broad FOLDER]
                                 [--logs FOLDER]

Rooms and vehicles are simulated; packets of one length, all channels at once, are left out at
random times, and each recording is replayed with gaps filled up to every limit. Steps found and
false; of vehicles passes found and false, what their moments are off, and how many fixes and points
of tracks there are. Walkers are ten walks of ``back-steps``, or of the people that
``published_walks.py`` tells of, with a packet lost in four seconds: F1 of their steps at 0.12 s.
The limits that ship, ``bridges_s`` of stages, were chosen here with seeds 3 and 4 and on
back-steps; others report. Headings are those of the BROAD trials at hand, or of a folder with
others, with as many packets lost: their errors, what they claim, and how many are within two
deviations, told of the losses and not.

Tracks are those of the phones of ``indoor-location-20``, or of the logs that ``phone_logs.py``
tells of, without satellite fixes, with a time lost in twenty seconds from the first marked place
on: how far they are off at the others [m], the square of that by what is claimed, and the part
within the claimed ellipse of 90 %; medians over recordings of each one's median or part.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING
from unittest import mock

import numpy as np
from heading_accuracy import MEASURED, claimed_errors, imported, rms
from pedestrian_accuracy import CHI2_90, claims, squares
from phone_logs import STAIRS, points_of, trial_of
from published_walks import unseen, write_back

import groundtrace as gt
from groundtrace.evaluation.matching import f1_score, match
from groundtrace.inertial.heading import HeadingStage
from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import checked_pipeline
from groundtrace.pipeline.engine import EventList, replay
from groundtrace.pipeline.source import Source
from groundtrace.simulate.recording import write
from groundtrace.simulate.road import VehicleOptions
from groundtrace.simulate.room import simulate_room
from groundtrace.simulate.room_plan import RoomOptions
from groundtrace.simulate.vehicle import simulate_vehicle
from groundtrace_codecs.events import Fix, Pass, StepEvent, TrackPoint
from groundtrace_codecs.importers.run import import_recording
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S, SignalBlock
from groundtrace_codecs.writer import write_recording

if TYPE_CHECKING:
    from collections.abc import Sequence

    from groundtrace_codecs.events import Event
    from groundtrace_codecs.signals import Stream

SIMULATED = {
    "room": lambda seed: simulate_room(RoomOptions(seed=seed)),
    "vehicle": lambda seed: simulate_vehicle(VehicleOptions(seed=seed)),
}
#: Lengths of packets [ms], and the limits that are tried [s]; None is what ships.
ROOM_MS, ROOM_LIMITS_S = (20, 50, 70, 90, 150), (0.02, 0.05, 0.1, None)
VEHICLE_MS, VEHICLE_LIMITS_S = (90, 110, 200, 300, 500), (0.1, 0.3, 0.6, None)
HEADING_MS = (90, 200, 300)
WALKER_MS, WALKER_LIMITS_S = (90, 150, 200, 300, 400), (0.1, 0.3, 0.6, None)
TRACK_MS = (500, 1000, 3000, 10000)
#: Lost packets a second.
ROOM_RATE, VEHICLE_RATE, WALKER_RATE, TRACK_RATE = 1.0, 0.2, 0.25, 0.05
#: Walks of back-steps: people and trials.
PEOPLE, TRIALS = (1, 5, 9, 13, 17), (2, 4)
STEP_S, PASS_S = 0.12, 1.0


def lose(source: Path, out: Path, packet_s: float, rate: float, since_s: float = 0.1) -> None:
    """Write a recording without some packets from a time on, all streams at once."""
    rng = np.random.default_rng(0)
    with Recording.open(source) as recording:
        blocks = [x for x in Source(recording, block_s=1e6) if isinstance(x, SignalBlock)]
        start_ns, length_s = blocks[0].start_ns, (blocks[-1].end_ns - blocks[0].start_ns) / NS_PER_S
        left_s = max(length_s - packet_s - 0.1 - since_s, 0.0)
        starts = since_s + np.sort(rng.uniform(0.0, left_s, round(rate * left_s)))
        streams: dict[str, tuple[Stream, str, list[SignalBlock]]] = {}
        for block in blocks:
            parts = streams.setdefault(block.topic, (block.stream, "f32le", []))[2]
            since_s = (block.sample_times() - start_ns) / NS_PER_S
            edges = np.searchsorted(since_s, np.column_stack([starts, starts + packet_s]))
            done = 0
            for first, stop in edges.tolist():
                if first > done:
                    parts.append(block.slice(done, first))
                done = max(done, stop)
            if done < len(block):
                parts.append(block.slice(done, len(block)))
        write_recording(
            out,
            list(streams.values()),
            geometry=recording.geometry,
            labels=recording.labels,
            force=True,
        )


def replayed(
    path: Path, pipeline: str, limit_s: float | None, settings: Sequence[str] = ()
) -> tuple[list[Event], Recording]:
    """Return the events of a replay with gaps filled up to a limit."""
    sink = EventList()
    with Recording.open(path) as recording:
        config = checked_pipeline(pipeline, settings)
        chain = build_pipeline(config, recording.geometry, recording.labels)
        bridge_s = chain.bridge_s if limit_s is None else limit_s
        replay(Source(recording, bridge_s=bridge_s), chain, [sink])
        return sink.events, recording


def steps(path: Path, pipeline: str, limit_s: float | None) -> tuple[int, int, int]:
    """Return how many steps are found, how many are false, and how many are true."""
    events, recording = replayed(path, pipeline, limit_s)
    found = np.array(sorted(e.time_ns for e in events if isinstance(e, StepEvent))) / NS_PER_S
    true = np.array([x.time_ns for x in recording.labels if x.kind == "step"]) / NS_PER_S
    pairs = match(true, found, STEP_S)
    return len(pairs), len(found) - len(pairs), len(true)


def walk(files: tuple[Path, ...], out: Path) -> Path:
    """Import a walk at the lower back, its placement stated, on a grid of times."""
    table, columns, truth = files
    stated = out.with_suffix(".toml")
    stated.write_text(
        columns.read_text().replace("[[stream]]", '[[stream]]\nplacement = "waist"', 1)
    )
    import_recording([table], out, map_path=stated, truth=truth)
    return out


def walks_of(data: Path, walks: Path | None, folder: Path) -> list[Path]:
    """Return the walks at hand, imported."""
    if walks is not None:
        paths = unseen(walks)
        return [walk(write_back(p, folder), folder / f"{p.stem}.mcap") for p in paths]
    made = []
    for code in (f"{person}-{trial}" for person in PEOPLE for trial in TRIALS):
        names = ("signal.csv", "map.toml", "truth.csv")
        files = tuple(data / "back-steps" / code / name for name in names)
        if files[0].exists():
            made.append(walk(files, folder / f"{code}.mcap"))
    return made


def walkers(made: list[Path], lossy: Path) -> None:
    """Print what becomes of steps of walkers."""
    print("walkers: F1 of steps within 0.12 s")
    print(f"{'filled up to':12}" + "".join(f"{ms:10} ms" for ms in (0, *WALKER_MS)))
    for limit_s in WALKER_LIMITS_S:
        cells = []
        for ms in (0, *WALKER_MS):
            total = np.zeros(3, int)
            for path in made:
                lose(path, lossy, ms / 1e3, WALKER_RATE if ms else 0.0)
                total += steps(lossy, "waist-steps", limit_s)
            found, false, true = total
            f1 = f1_score(true, found + false, found)
            cells.append(f"{f1:13.3f}")
        print(f"{named(limit_s):12}" + "".join(cells), flush=True)


def heading_off(path: Path, *, tell: bool) -> np.ndarray:
    """Return errors of headings and what they claim, shape (2, n) [deg]."""
    untold = mock.patch.object(HeadingStage, "filled")
    with nullcontext() if tell else untold:
        events, recording = replayed(path, "heading", None, MEASURED)
    return np.degrees(claimed_errors(recording.labels, events)[1:])


def headings(trials: list[Path], folder: Path) -> None:
    """Print what becomes of headings whose truth is known."""
    print(f"headings of {len(trials)} trials: lost [ms], told, off and claimed [deg], within two")
    made, lossy = [imported(path, folder) for path in trials], folder / "lossy.mcap"
    for ms in (0, *HEADING_MS):
        rows: dict[bool, list[np.ndarray]] = {True: [], False: []}
        for path in made:
            lose(path, lossy, ms / 1e3, WALKER_RATE if ms else 0.0)
            for tell, parts in rows.items():
                parts.append(heading_off(lossy, tell=tell))
        for tell, parts in rows.items():
            off, claimed = np.concatenate(parts, axis=1)
            within = np.mean(np.abs(off) < 2 * claimed)
            said = "yes" if tell else "no"
            print(f"{ms:4} {said:4}{rms(off):8.2f}{rms(claimed):8.2f}{within:8.3f}", flush=True)


def track_figures(path: Path) -> tuple[float, float, float]:
    """Return how far a track is off [m], its normalised squares, and the part within ellipses.

    At marked places, from the first of them on; NaN where fewer than three are passed.
    """
    with Recording.open(path) as recording:
        places = tuple(x for x in recording.labels if x.kind == "waypoint")
    points = points_of(gt.replay(path, "pedestrian", {"track.updates": "none"}))
    off, spread = claims(points, places) if points else (np.empty((0, 2)), np.empty((0, 2, 2)))
    if len(off) <= 2:
        return np.nan, np.nan, np.nan
    off, spread = (off - off[0])[1:], spread[1:]
    far, normalised = np.linalg.norm(off, axis=1), squares(off, spread)
    return float(np.median(far)), float(np.median(normalised)), np.mean(normalised <= CHI2_90)


def tracks(sources: Sequence[Path], folder: Path) -> None:
    """Print what becomes of tracks of phones."""
    print(f"tracks of {len(sources)} phones: lost [ms], off [m], squares, within")
    made, lossy = folder / "phone.mcap", folder / "lossy.mcap"
    rows: dict[int, list[tuple[float, float, float]]] = {}
    for source in sources:
        import_recording([source], made, force=True)
        with Recording.open(made) as recording:
            first_ns = min(x.time_ns for x in recording.labels if x.kind == "waypoint")
            since_s = (first_ns - recording.start_ns) / NS_PER_S + 5.0
        for ms in (0, *TRACK_MS):
            lose(made, lossy, ms / 1e3, TRACK_RATE if ms else 0.0, since_s)
            rows.setdefault(ms, []).append(track_figures(lossy))
    for ms, found in rows.items():
        off_m, squares, part = np.nanmedian(found, axis=0)
        print(f"{ms:6}{off_m:8.1f}{squares:8.2f}{part:8.2f}", flush=True)


def phone_logs(data: Path, logs: Path | None) -> list[Path]:
    """Return the logs of phones at hand, or of a folder those on one floor."""
    if logs is None:
        return sorted(data.glob("indoor-location-20/**/path_data_files/*.txt"))
    return [path for path in sorted(logs.glob("*.txt")) if trial_of(path) < STAIRS]


def vehicles(path: Path, limit_s: float | None) -> tuple[int, int, float, int]:
    """Return passes found and false, their median error [s], and points of tracks."""
    events, recording = replayed(path, "vehicle-passes", limit_s)
    found = np.array(sorted(e.time_ns for e in events if isinstance(e, Pass))) / NS_PER_S
    true = np.array([x.time_ns for x in recording.labels if x.kind == "pass"]) / NS_PER_S
    pairs = match(true, found, PASS_S)
    off = np.abs(found[pairs[:, 1]] - true[pairs[:, 0]])
    tracked, _ = replayed(path, "vehicle-tracks", limit_s)
    points = sum(isinstance(e, (Fix, TrackPoint)) for e in tracked)
    return (
        len(pairs),
        len(found) - len(pairs),
        float(np.median(off)) if len(off) else np.nan,
        points,
    )


def named(limit_s: float | None) -> str:
    """Return how a limit is called in a table."""
    return "as ships" if limit_s is None else f"{1e3 * limit_s:.0f} ms"


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, nargs="*", default=[3, 4, 5, 6])
    parser.add_argument(
        "--data", type=Path, default=Path(os.environ.get("GROUNDTRACE_DATA", "../shared/data"))
    )
    parser.add_argument("--walks", type=Path, help="GaitData as published: people never at hand")
    parser.add_argument("--logs", type=Path, help="logs of IPIN 2023 other than phones of --data")
    parser.add_argument("--broad", type=Path, help="trials of BROAD other than those of --data")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        made = {}
        for kind in ("room", "vehicle"):
            made[kind] = [folder / f"{kind}{seed}.mcap" for seed in options.seeds]
            for seed, path in zip(options.seeds, made[kind], strict=True):
                write(SIMULATED[kind](seed), path)
        lossy = folder / "lossy.mcap"
        if phones := phone_logs(options.data, options.logs):
            tracks(phones, folder)
        if walks := walks_of(options.data, options.walks, folder):
            walkers(walks, lossy)
        at_hand = options.broad or options.data / "broad"
        trials = [path for kind in ("mat", "hdf5") for path in at_hand.rglob(f"*.{kind}")]
        if trials:
            headings(sorted(trials), folder)
        if not options.seeds:
            return
        print("rooms: steps found, false; by the length of lost packets, one a second")
        print(f"{'filled up to':12}" + "".join(f"{ms:7} ms" for ms in (0, *ROOM_MS)))
        for limit_s in ROOM_LIMITS_S:
            cells = []
            for ms in (0, *ROOM_MS):
                total = np.zeros(2, int)
                for path in made["room"]:
                    lose(path, lossy, ms / 1e3, ROOM_RATE if ms else 0.0)
                    total += steps(lossy, "room-steps", limit_s)[:2]
                cells.append(f"{total[0]:6},{total[1]:3}")
            print(f"{named(limit_s):12}" + "".join(cells), flush=True)
        print("vehicles: passes found, false, moments off [s], fixes and points of tracks")
        print(f"{'filled up to':12}" + "".join(f"{ms:17} ms" for ms in (0, *VEHICLE_MS)))
        for limit_s in VEHICLE_LIMITS_S:
            cells = []
            for ms in (0, *VEHICLE_MS):
                rows = []
                for path in made["vehicle"]:
                    lose(path, lossy, ms / 1e3, VEHICLE_RATE if ms else 0.0)
                    rows.append(vehicles(lossy, limit_s))
                found, false, off, points = np.array(rows).T
                cells.append(
                    f"{found.sum():6.0f},{false.sum():3.0f},{np.nanmedian(off):5.2f},"
                    f"{points.sum():4.0f}"
                )
            print(f"{named(limit_s):12}" + "".join(cells), flush=True)


if __name__ == "__main__":
    main()
