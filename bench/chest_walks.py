"""Headings of a walker's first steps against the orientation that the sensor itself computes.

    python bench/chest_walks.py --walks FOLDER

The folder holds the recordings of
github.com/eternalamit5/An-improved-wearable-multi-sensor-fusion-Pedestrian-Dead-Reckoning-system-for-indoor-localisation
(MIT): an Xsens MTi-3 at the chest, 100 Hz, indoors, with roll, pitch and yaw of its own filter;
those of ``Data`` and ``Robust Adaptive Kalman Filter Algorithm/RawData`` in which somebody walks.
How the sensor is turned about the vertical is not told, so that the headings of a recording are
compared but for their mean over all steps after the fifteenth. Nothing was chosen on them.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation
from stairs_and_runs import written

import groundtrace as gt

#: Rows of the files: time [0.1 ms], the nine columns, roll, pitch, yaw [deg].
TIME, WORN, ANGLES = 1, slice(2, 11), slice(11, 14)
#: Fewer steps tell no mean, and steps up to the first number are first ones.
LEAST, EARLY, MEAN_FROM = 25, 10, 15


def main() -> None:
    """Print how far headings are off, and what they claim."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--walks", type=Path, required=True)
    given = parser.parse_args()
    first, later = [], []
    recordings = 0
    for path in sorted(given.walks.rglob("*.txt")):
        rows = np.genfromtxt(path, delimiter=",", skip_header=1, invalid_raise=False)
        rows = rows[np.isfinite(rows).all(axis=1)]
        if rows.shape[1] != ANGLES.stop:
            continue
        time_s = (rows[:, TIME] - rows[0, TIME]) * 1e-4
        if (np.diff(time_s) <= 0).any():
            time_s = np.arange(len(rows)) / 100
        with tempfile.TemporaryDirectory() as folder:
            values = np.column_stack([time_s, rows[:, WORN]])
            walk = written(values, "trunk", Path(folder) / "walk.mcap")
            told = gt.replay(walk, "pedestrian").headings
        if len(told.time_s) < LEAST:
            continue
        recordings += 1
        turned = Rotation.from_euler("ZYX", rows[:, ANGLES][:, ::-1], degrees=True)
        ahead = turned.apply([0.0, 0.0, 1.0])  # the sensor's z looks along the chest
        own = np.interp(told.time_s, time_s, np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0])))
        apart = np.exp(1j * (told.heading_rad - own))
        off = np.abs(np.angle(apart / apart[MEAN_FROM:].mean()))
        pairs = np.column_stack([off, told.sigma_rad])
        first.append(pairs[:EARLY])
        later.append(pairs[EARLY:])
    print(f"{recordings} walks")
    for name, parts in (("the first ten steps", first), ("later ones", later)):
        off, sigma = np.concatenate(parts).T
        rms, claim = np.degrees([np.sqrt(np.mean(off**2)), np.median(sigma)])
        within = [100 * np.mean(off < k * sigma) for k in (1, 2)]
        print(
            f"  {name}: {len(off)}, {rms:.1f} deg off (rms), claims {claim:.1f} deg (median); "
            f"{within[0]:.0f} and {within[1]:.0f} % within one and two deviations"
        )


if __name__ == "__main__":
    main()
