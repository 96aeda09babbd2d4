"""Steps by a phone in the hand or a pocket against pods on both shoes.

    python bench/pod_steps.py --recordings FOLDER

The folder is ``dataset/raw`` of github.com/joclement/step-detector (TU Berlin, Apache-2.0): 18
recordings of accelerometer and gyroscope at 200 Hz, held upright, level, turned from one to the
other on the way, rocked up and down, or in a pocket; people walk, stand, march on the spot, turn
and climb. A pod tells each stride once or more often, and misses some; its times come by radio up
to a second late, so that steps are counted. Rivals: ``waist-peaks``, and a metronome of the pods'
own rhythm, from the first stride to the last.

Those of 2018-01-21 chose the part that turns count for under a steady rhythm (``STEADY_PART``).
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import groundtrace as gt
from groundtrace_codecs.importers.run import import_recording

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

MAP = """format = "csv"
time = {column = "time_s", unit = "s"}
[[stream]]
topic = "/imu"
placement = "phone"
columns = [
"""
COLUMNS = {
    "Accelerometer": ("acceleration", "m/s2"),
    "Gyroscope": ("angular_velocity", "rad/s"),
}
PIPELINES = ("waist-steps", "waist-peaks")


def read(path: Path) -> tuple[Array, Array]:
    """Return times on the phone's clock [s], and values, of a sensor's file."""
    rows = np.genfromtxt(path, delimiter=",", skip_header=1, usecols=range(5))
    rows = rows[np.isfinite(rows).all(axis=1)]
    # events have clocks of their own, arrivals come late now and then
    time_s = (rows[:, 1] + np.median(rows[:, 0] - rows[:, 1])) * 1e-9
    forward = np.diff(time_s, prepend=-np.inf) > 0
    return time_s[forward], rows[forward, 2:]


def strides(path: Path) -> Array:
    """Return the times of a pod's strides on the phone's clock [s], each once."""
    rows = np.atleast_2d(np.genfromtxt(path, delimiter=",", skip_header=1, usecols=(0, 1)))
    pod_s = np.unique(rows[:, 1]) * 1e-3
    return pod_s + float(np.min(rows[:, 0] * 1e-9 - rows[:, 1] * 1e-3))


def imported(folder: Path, scratch: Path) -> Path:
    """Return a recording of a folder: both sensors at the times of the accelerometer."""
    sensors = {name: read(folder / f"{name}.csv") for name in COLUMNS}
    begin = max(time_s[0] for time_s, _ in sensors.values())
    end = min(time_s[-1] for time_s, _ in sensors.values())
    time_s = sensors["Accelerometer"][0]
    time_s = time_s[(time_s >= begin) & (time_s <= end)]
    table = [time_s - time_s[0]]
    text, names = MAP, ["time_s"]
    for name, (quantity, unit) in COLUMNS.items():
        since, values = sensors[name]
        for axis, column in zip("xyz", values.T, strict=True):
            table.append(np.interp(time_s, since, column))
            names.append(f"{name}_{axis}")
            text += f'  {{column = "{names[-1]}", quantity = "{quantity}", '
            text += f'axis = "{axis}", unit = "{unit}"}},\n'
    map_path, csv, path = (scratch / f"{folder.name}{kind}" for kind in (".toml", ".csv", ".mcap"))
    map_path.write_text(text + "]\n", encoding="utf-8")
    np.savetxt(csv, np.stack(table, 1), "%.6f", ",", header=",".join(names), comments="")
    import_recording([csv], path, map_path=map_path)
    return path


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recordings", type=Path, required=True)
    folder = parser.parse_args().recordings
    folders = [*sorted(folder.glob("benni*/benjamin*")), *sorted(folder.glob("record*"))]
    print(f"{'recording':32}{'pods':>6}" + "".join(f"{p:>13}" for p in (*PIPELINES, "metronome")))
    counts = []
    with tempfile.TemporaryDirectory() as scratch:
        for each in folders:
            path = imported(each, Path(scratch))
            pods = [strides(each / f"{side}FootSensor.csv") for side in ("Left", "Right")]
            true_s = np.sort(np.concatenate(pods))
            row = [float(len(true_s))]
            row += [float(len(gt.replay(path, pipeline).steps.time_s)) for pipeline in PIPELINES]
            row.append(np.ptp(true_s) / float(np.median(np.diff(pods[0]))) * 2)
            counts.append(row)
            print(f"{each.name:32}{row[0]:6.0f}" + "".join(f"{n:13.0f}" for n in row[1:]))
    table = np.array(counts)
    off = np.abs(table[:, 1:] - table[:, :1]).sum(axis=0) / table[:, 0].sum()
    print(
        f"{'sum':32}{table[:, 0].sum():6.0f}" + "".join(f"{n:13.0f}" for n in table[:, 1:].sum(0))
    )
    print(f"{'off, of all [%]':38}" + "".join(f"{100 * part:13.1f}" for part in off))


if __name__ == "__main__":
    main()
