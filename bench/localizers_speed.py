"""Cost of one step in a room: the correlation of all sensors, and every localizer.

Waveforms and arrivals are those of a simulated room of 4, 9 and 16 sensors at 20 kHz; what is
timed is what a pipeline does with each step, warm, as CPU time of the process. The arrangement of
regions, made once, stands beside it, and a peer, timed before and after: the delays of all pairs by
whitened spectra (PHAT) of 50 ms in plain numpy.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from timing import alone, taken_s

from groundtrace.localizers.arrival_order import find_regions
from groundtrace.localizers.base import outline_of
from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import load_pipeline
from groundtrace.pipeline.engine import replay
from groundtrace.pipeline.source import Source
from groundtrace.simulate.recording import write
from groundtrace.simulate.room import simulate_room
from groundtrace.simulate.room_plan import RoomOptions
from groundtrace_codecs.recording import Recording

if TYPE_CHECKING:
    from collections.abc import Callable

    from groundtrace.pipeline.stage import Stage

#: What of each kind of worker is timed.
TIMED = ("examine", "locate")


@dataclass
class Timed:
    """CPU times of one method of a plugin [s], by the stage's name."""

    taken: dict[str, list[float]] = field(default_factory=dict)

    def wrapped(self, stage: Stage) -> None:
        """Let a stage's plugin be timed; others are left alone."""
        kind: Any = getattr(stage, "kind", None)
        for name in TIMED:
            if hasattr(kind, name):
                stage.kind = self._timed_kind(stage.name, kind, name)  # type: ignore[attr-defined]

    def _timed_kind(self, stage: str, kind: type[Any], name: str) -> type[Any]:
        method: Callable[..., Any] = getattr(kind, name)
        taken = self.taken.setdefault(stage, [])

        def timed(worker: Any, given: Any) -> Any:
            began = time.process_time()
            output = method(worker, given)
            taken.append(time.process_time() - began)
            return output

        return type(kind.__name__, (kind,), {name: timed})


def per_step(path: Path) -> dict[str, list[float]]:
    """Replay a room; return the CPU times of each stage's steps [s]."""
    timed = Timed()
    with Recording.open(path) as recording:
        pipeline = build_pipeline(load_pipeline("room-footsteps"), recording.geometry)
        for stage in pipeline.stages:
            timed.wrapped(stage)
        replay(Source(recording), pipeline, [])
    return timed.taken


def arrangement_s(sensors: int) -> tuple[float, int]:
    """Return the CPU time of arranging the regions of sensors at random [s], and their number."""
    places = np.random.default_rng(sensors).uniform(0, 10, (sensors, 2))
    room = outline_of(places, np.array([(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0)]))
    began = time.process_time()
    regions = find_regions(places, room)
    return time.process_time() - began, len(regions)


def phat_of_all_pairs(sensors: int) -> list[float]:
    """Return the CPU times of the peer [s]."""
    waves = np.random.default_rng(0).normal(size=(sensors, 1000))
    one, other = np.triu_indices(sensors, 1)

    def delays() -> object:
        spectra = np.fft.rfft(waves, 2048)
        cross = spectra[one] * spectra[other].conj()
        return np.fft.irfft(cross / np.abs(cross)).argmax(axis=1)

    return [taken_s(delays) for _ in range(30)]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--sensors", type=int, nargs="+", default=[4, 9, 16])
    options = parser.parse_args()
    alone()
    print("median and mean of a step, CPU time [ms] (median, as a multiple of the peer's)")
    with tempfile.TemporaryDirectory() as folder:
        for sensors in options.sensors:
            path = Path(folder) / f"{sensors}.mcap"
            room = RoomOptions(duration_s=options.seconds, channels=sensors, rate_hz=20_000.0)
            write(simulate_room(room), path)
            per_step(path)
            peers = phat_of_all_pairs(sensors)
            stage_times = per_step(path)
            peer_s = statistics.median([*peers, *phat_of_all_pairs(sensors)])
            cells = [
                f"{stage} {statistics.median(taken) * 1e3:.2f}/{statistics.mean(taken) * 1e3:.2f}"
                f" ({statistics.median(taken) / peer_s:.2f})"
                for stage, taken in stage_times.items()
                if taken
            ]
            once_s, regions = arrangement_s(sensors)
            print(f"{sensors:2} sensors: {', '.join(cells)}; {regions} regions in {once_s:.2f} s")


if __name__ == "__main__":
    main()
