"""Tracks of phones in buildings: the logs of the IPIN competition of 2023, track 3.

    python bench/phone_logs.py --logs FOLDER [--iron 16 -12 20]

The folder holds the training trials as text, as GetSensorData wrote them (J. Torres-Sospedra et
al., Zenodo 8362205, CC BY 4.0): two people with two phones on three floors, some up and down stairs
or in a lift, each first standing for a minute in which the phone is waved to calibrate its compass,
then on a way with marked places. Nobody knows where they went before the first of them.

- Steps told while the phone was waved, and of the way.
- Satellite fixes: how many lie within the accuracy that they say, which is to hold 68 %.
- Tracks without fixes, turned and shifted onto the marked places: root mean square [m]; those of
  the compass alone beside them. By how much they had to be turned [deg].
- Headings of the phone's y axis, in the mean over a way of 5 m or more between two marked places on
  which it hardly turns: the median of what they are off by, and of what they claim [deg], and the
  part that is off by no more than twice that.
- Tracks with fixes: the median distance from the marked places but the first [m], the part of all
  within the claimed ellipse of 90 %, and what the nearest fixes alone are off by.

With ``--iron`` the phones carry iron that adds so much to their fields, along their axes [uT].

Trials of odd number chose ``QUIET_SCATTER``; the others had been seen by then, too.
"""

from __future__ import annotations

import argparse
import re
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from pedestrian_accuracy import inside

import groundtrace as gt
from groundtrace.evaluation.positions import (
    score_closure,
    score_waypoints,
    true_places,
    turn_onto,
)
from groundtrace_codecs.events import Label, TrackPoint
from groundtrace_codecs.geometry import tangent_plane
from groundtrace_codecs.importers.run import import_recording
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import ACCURACY, NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Sequence

#: Trials from this number on go up and down stairs.
STAIRS = 50
#: A fix counts for a marked place that is no farther from it in time [s].
NEAR_S = 1.5
#: A way is looked at that is longer [m], without its first and last second, with so many headings,
#: whose mean vector is so long.
WAY_M, WAY_END_NS, WAY_LEAST, WAY_STRAIGHT = 5.0, NS_PER_S, 20, 0.95
COLUMNS = (
    *("waved", "walked", "hold", "fixes off", "shape", "compass", "turned"),
    *("heading", "claimed", "within", "off", "inside"),
)


def points_of(result: gt.Results) -> list[TrackPoint]:
    """Return the points of the smoothed track."""
    table = result.tracks
    columns = (table.time_ns, table.track, table.x_m, table.y_m, table.vx_mps, table.vy_mps)
    spreads = zip(
        table.covariance_xx_m2, table.covariance_xy_m2, table.covariance_yy_m2, strict=True
    )
    rows = zip(*columns, spreads, table.stage, strict=True)
    return [TrackPoint(*row) for row in rows if row[-1] == "track.smoothed"]


def shape_m(points: list[TrackPoint], labels: tuple[Label, ...]) -> float:
    """Return the root mean square after the best turn and shift [m]."""
    score = score_closure(true_places(labels), points)
    return float("nan") if score is None or score.aligned_rmse_m is None else score.aligned_rmse_m


def turned_deg(points: list[TrackPoint], times_ns: np.ndarray, true: np.ndarray) -> float:
    """Return by how much a track is turned against marked places [deg]."""
    since, tracked = [p.time_ns for p in points], ([p.x_m for p in points], [p.y_m for p in points])
    spots = np.stack([np.interp(times_ns, since, column) for column in tracked], axis=1)
    (cosine, _), (sine, _) = turn_onto(spots, np.stack([true.real, true.imag], axis=1)).rotation
    return abs(float(np.degrees(np.arctan2(sine, cosine))))


def trial_of(log: Path) -> int:
    """Return the number of the trial of a log; 0 where its name has none."""
    trial = re.search(r"(\d+)_repetition", log.stem)
    return int(trial[1]) if trial else 0


def with_iron(text: str, iron_ut: Sequence[float]) -> str:
    """Return a log whose phone carries iron."""

    def laden(line: re.Match[str]) -> str:
        fields = (float(x) + more for x, more in zip(line[2].split(";"), iron_ut, strict=True))
        return line[1] + ";".join(f"{x:.5f}" for x in fields)

    number = r"-?[\d.]+(?:[eE][-+]?\d+)?"
    pattern = rf"^(MAGN;{number};{number};)({number};{number};{number})"
    return re.sub(pattern, laden, text, flags=re.MULTILINE)


def of_fixes(opened: Recording, times_ns: np.ndarray, true: np.ndarray) -> tuple[float, float]:
    """Return how many of the fixes near marked places hold what they say, and their error [m]."""
    plane = tangent_plane(opened.geometry)
    blocks = [b for _, b in opened.blocks() if b.stream.columns_of(ACCURACY)]
    if not blocks:
        return np.nan, np.nan
    since = np.concatenate([b.sample_times() for b in blocks])
    values = np.concatenate([b.values for b in blocks])
    nearest = np.abs(since[:, None] - times_ns).argmin(axis=0)
    heard = np.abs(since[nearest] - times_ns) < NEAR_S * NS_PER_S
    spots = np.array([plane.map_position(*np.radians(row[:2])) for row in values[nearest]])
    off = np.abs(spots @ np.array([1, 1j]) - true)[heard]
    (column,) = blocks[0].stream.columns_of(ACCURACY)
    if not heard.any():
        return np.nan, np.nan
    return float(np.mean(off < values[nearest, column][heard])), float(np.median(off))


def of_headings(path: Path, times_ns: np.ndarray, true: np.ndarray) -> tuple[float, ...]:
    """Return the medians of errors of headings and their claims [deg], and the part within two."""
    found = gt.replay(path, "heading", {"heading.axis": "y"}).headings
    since, sigma_rad = np.asarray(found.time_ns), np.asarray(found.sigma_rad)
    vectors, rows = np.exp(1j * np.asarray(found.heading_rad)), []
    for k, way in enumerate(np.diff(true)):
        start_ns, stop_ns = times_ns[k] + WAY_END_NS, times_ns[k + 1] - WAY_END_NS
        at = slice(*np.searchsorted(since, [start_ns, stop_ns]))
        mean = vectors[at].mean() if at.stop - at.start >= WAY_LEAST else 0j
        if abs(way) >= WAY_M and abs(mean) >= WAY_STRAIGHT:
            rows.append((abs(np.angle(mean / way)), np.median(sigma_rad[at])))
    if not rows:
        return np.nan, np.nan, np.nan
    off, claimed = np.degrees(rows).T
    return np.median(off), np.median(claimed), np.mean(off < 2 * claimed)


def row_of(path: Path) -> list[float]:
    """Return the figures of one recording, as :data:`COLUMNS`."""
    with Recording.open(path) as opened:
        labels = tuple(x for x in opened.labels if x.kind == "waypoint")
        times_ns = np.array([x.time_ns for x in labels])
        true = np.array([complex(x.x_m or 0.0, x.y_m or 0.0) for x in labels])
        hold, fixes_m = of_fixes(opened, times_ns, true)
    blind = gt.replay(path, "pedestrian", {"track.updates": "none"})
    steps_ns = np.asarray(blind.steps.time_ns)
    compass = gt.replay(path, "pedestrian-compass", {"track.updates": "none"})
    shapes = [shape_m(points_of(x), labels) for x in (blind, compass)]
    turned = turned_deg(points_of(blind), times_ns, true)
    points = points_of(gt.replay(path, "pedestrian"))
    score = score_waypoints(labels, points)
    off_m = float("nan") if score is None else score.median_m
    waved = float((steps_ns < times_ns[0] - NS_PER_S).sum())
    walked = len(steps_ns) - waved
    headings = of_headings(path, times_ns, true)
    return [waved, walked, hold, fixes_m, *shapes, turned, *headings, off_m, inside(points, labels)]


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--logs", type=Path, required=True)
    parser.add_argument("--iron", type=float, nargs=3, default=(0.0, 0.0, 0.0), metavar="UT")
    options = parser.parse_args()
    rows: dict[int, list[list[float]]] = {}
    print(f"{'trial':28}" + "".join(f"{c:>11}" for c in COLUMNS))
    with tempfile.TemporaryDirectory() as scratch:
        for log in sorted(options.logs.glob("*.txt")):
            path, laden = (Path(scratch) / f"{log.stem}{kind}" for kind in (".mcap", ".txt"))
            text = log.read_text(encoding="utf-8", errors="surrogateescape")
            text = with_iron(text, options.iron) if any(options.iron) else text
            laden.write_text(text, encoding="utf-8", errors="surrogateescape")
            import_recording([laden], path)
            row = row_of(path)
            rows.setdefault(trial_of(log), []).append(row)
            print(f"{log.stem[-28:]:28}" + "".join(f"{x:11.2f}" for x in row), flush=True)
    groups = {
        "odd, level": lambda n: n < STAIRS and n % 2,
        "even, level": lambda n: n < STAIRS and not n % 2,
        "stairs and lift": lambda n: n >= STAIRS,
    }
    for name, belongs in groups.items():
        kept = np.array([row for n, some in rows.items() if belongs(n) for row in some])
        if len(kept):
            sums, middles = np.nansum(kept[:, :2], axis=0), np.nanmedian(kept[:, 2:], axis=0)
            print(f"{name:18}{len(kept):10}" + "".join(f"{x:11.2f}" for x in (*sums, *middles)))


if __name__ == "__main__":
    main()
