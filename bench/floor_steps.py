"""Steps on real floors by one cheap sensor, where no onset can be picked; and of noise alone.

    python bench/floor_steps.py [--recordings FOLDER]

Simulated rooms (``simulate room``), resampled to lower rates, and white noise, each by one channel:
steps found and false, and false ones a minute. Rivals: ``room-steps``; peaks of the power over a
tenth of a second above 2.5 times its lower third, at least 0.35 s apart; and a metronome of the
walk's own interval, begun anywhere.

With ``--recordings`` the data sets of github.com/Capstone-Gait-Keepers/capstone (no licence given:
nothing of it is kept here): three floors, an accelerometer on the floor at 100 Hz, piezo discs at
200 and 500 Hz, quantised to a few steps, walkers in socks and slippers that shuffle, limp, stop and
turn. The walker pressed a button at each step, some 0.09 s before the floor shows most of it; that
is added to the truth, and steps count from the first press to the last. Those of 2023 (``early``)
chose ``ratio`` and the length of the window, the others nothing.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import yaml
from scipy.signal import butter, find_peaks, resample_poly, sosfilt

import groundtrace as gt
from groundtrace.evaluation.matching import f1_score, match
from groundtrace.simulate.room import simulate_room
from groundtrace.simulate.room_plan import RoomOptions
from groundtrace_codecs.importers.run import import_recording
from groundtrace_codecs.signals import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

#: A step counts within this of the truth [s]; the button comes earlier by that [s]; steps count
#: from so long before the first press to so long after the last [s].
TOLERANCE_S, PRESSED_S, AROUND_S = 0.12, 0.09, 0.3
RATES_HZ = (100, 200, 500, 1000, 4000)
SEEDS = (1, 2, 3)
NOISE_S = 300.0
#: Data sets: folder, rate [Hz], quantity, unit.
KINDS = {
    "bno055": (100, "ground_acceleration", "m/s2"),
    "piezo": (200, "voltage", "V"),
    "piezo_custom": (500, "voltage", "V"),
}
COLUMNS = f"{'':18}{'method':14}{'steps':>7}{'recall':>9}{'precision':>11}{'F1':>8}"


def peaks(signal: Array, rate_hz: float) -> Array:
    """Return the times of peaks of the power [s], the simplest rival."""
    edges = [5.0, min(45.0, 0.45 * rate_hz)]
    band = sosfilt(butter(2, edges, "band", fs=rate_hz, output="sos"), signal - np.median(signal))
    width = max(1, round(0.1 * rate_hz))
    power = np.convolve(band * band, np.ones(width) / width, "same")
    least = 2.5 * np.quantile(power, 0.3)
    return find_peaks(power, height=least, distance=max(1, round(0.35 * rate_hz)))[0] / rate_hz


def metronome(true_s: Array, seconds: float) -> Array:
    """Return the times of a metronome of the walk's interval [s]."""
    interval_s = float(np.median(np.diff(true_s)))
    return np.arange(np.random.default_rng(0).uniform(0, interval_s), seconds, interval_s)


def methods(signal: Array, rate_hz: float, quantity: str, unit: str) -> Iterator[tuple[str, Array]]:
    """Yield what each method finds in one channel [s]."""
    with tempfile.TemporaryDirectory() as scratch:
        table, map_path = Path(scratch) / "floor.npz", Path(scratch) / "map.toml"
        np.savez(table, v=signal.astype(np.float32))
        map_path.write_text(
            f'format = "npz"\nrate_hz = {rate_hz:.1f}\n[[stream]]\ntopic = "/floor"\n'
            f'columns = [{{column="v", quantity="{quantity}", axis="z", unit="{unit}"}}]\n',
            encoding="utf-8",
        )
        path = Path(scratch) / "floor.mcap"
        import_recording([table], path, map_path=map_path)
        for name in ("floor-steps", "room-steps"):
            found = gt.replay(path, name, {"steps.min_channels": 1})
            yield name, np.asarray(found.steps.time_s)
    yield "peaks", peaks(signal, rate_hz)


class Scores:
    """Counts of each method: hits, true and found steps."""

    def __init__(self) -> None:
        self.of: dict[str, Array] = {}

    def add(self, method: str, found_s: Array, true_s: Array) -> None:
        """Count a recording in."""
        inside = (found_s > true_s[0] - AROUND_S) & (found_s < true_s[-1] + AROUND_S)
        found_s = found_s[inside]
        hits = len(match(true_s, found_s, TOLERANCE_S))
        self.of[method] = self.of.get(method, 0) + np.array([hits, len(true_s), len(found_s)])

    def show(self, title: str) -> None:
        """Print a row each."""
        for method, (hit, true, found) in self.of.items():
            recall, precision = hit / true, hit / max(found, 1)
            row = f"{recall:9.2f}{precision:11.2f}{f1_score(true, found, hit):8.2f}"
            print(f"{title:18}{method:14}{true:7.0f}{row}", flush=True)


def print_rooms() -> None:
    """Simulated rooms at lower rates."""
    rooms = []
    for seed in SEEDS:
        room = simulate_room(RoomOptions(seed=seed))
        ((stream, _, source),) = room.sources
        blocks = list(source)
        signal = np.concatenate([b.values[:, 0] for b in blocks])
        times_ns = np.array([x.time_ns for x in room.labels if x.kind == "step"])
        rooms.append((signal, stream.rate_hz, (times_ns - blocks[0].start_ns) / NS_PER_S))
    for rate in RATES_HZ:
        scores = Scores()
        for signal, rate_hz, true_s in rooms:
            lower = resample_poly(signal, rate, round(rate_hz))
            for method, found_s in methods(lower, rate, "ground_velocity", "m/s"):
                scores.add(method, found_s, true_s)
        scores.show(f"rooms, {rate} Hz")


def print_noise() -> None:
    """False steps of white noise."""
    print(f"\n{'white noise':18}{'method':14}{'false a minute':>16}")
    for rate in RATES_HZ:
        signal = np.random.default_rng(rate).standard_normal(round(NOISE_S * rate))
        for method, found_s in methods(signal, rate, "ground_velocity", "m/s"):
            print(f"{rate:6} Hz{'':9}{method:14}{60 * len(found_s) / NOISE_S:16.1f}", flush=True)


def print_floors(folder: Path) -> None:
    """Real floors."""
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    groups: dict[str, Scores] = {}
    for kind, (rate, quantity, unit) in KINDS.items():
        for path in sorted((folder / kind).glob("*.y*ml")):
            document = yaml.load(path.read_text(encoding="utf-8"), loader)
            pressed = [e["timestamp"] for e in document["events"] or [] if e["category"] == "step"]
            if not pressed:
                continue
            true_s = np.array(pressed) + PRESSED_S
            signal = np.array(document["ts"], float)
            early = ", early" if path.stem < "2024" and kind == "bno055" else ""
            scores = groups.setdefault(f"{kind}{early}", Scores())
            for method, found_s in methods(signal, rate, quantity, unit):
                scores.add(method, found_s, true_s)
            scores.add("metronome", metronome(true_s, len(signal) / rate), true_s)
    for title, scores in groups.items():
        scores.show(title)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recordings", type=Path)
    options = parser.parse_args()
    print(COLUMNS)
    if options.recordings:
        print_floors(options.recordings)
    print_rooms()
    print_noise()


if __name__ == "__main__":
    main()
