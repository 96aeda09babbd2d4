"""The whole job by parts: a room with places, results and timeline, and its command by the clock.

A simulated room of 16 channels at 20 kHz is replayed through ``room-footsteps`` on one core, with a
results file and a timeline. Each part's CPU time is the least of all runs [ms per recorded second];
reading comes before the stages, passing on is all that lies between them. Below, whole processes
take turns by the clock, start and exit included: the same replay as a command, without a timeline,
against the script that reads miniSEED of the same samples, filters and picks them with ObsPy.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

from replay_speed import CHANNELS, RATE_HZ, room, samples_of, write_miniseed
from timing import alone, on_one_core

from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import load_pipeline
from groundtrace.pipeline.engine import ReplaySession, replay
from groundtrace.pipeline.results import Provenance, ResultsSink
from groundtrace.pipeline.source import Source
from groundtrace_codecs.recording import Recording
from groundtrace_viewers import RerunSink

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from groundtrace.pipeline.engine import Item

PIPELINE = "room-footsteps"
SCRIPT = """
import sys
from obspy import read
from obspy.signal.trigger import recursive_sta_lta, trigger_onset

stream = read(sys.argv[1])
stream.detrend("demean")
stream.filter("bandpass", freqmin=20, freqmax=2000, corners=4)
for trace in stream:
    trigger_onset(recursive_sta_lta(trace.data, 40, 2000), 5, 2)
"""


class PartTimes(Counter[str]):
    """CPU times of parts [s], by name."""

    def timed(self, part: str, method: Callable[..., Any]) -> Callable[..., Any]:
        """Return a method whose time is added to that of a part."""

        def run(*given: Any) -> Any:
            began = time.process_time()
            try:
                return method(*given)
            finally:
                self[part] += time.process_time() - began

        return run

    def wrap(self, part: str, owner: Any, *names: str) -> None:
        """Let methods of an object be timed."""
        for name in names:
            setattr(owner, name, self.timed(part, getattr(owner, name)))

    def read(self, source: Source) -> Iterator[Item]:
        """Yield what a source gives."""
        following = self.timed("reading", iter(source).__next__)
        while True:
            try:
                item = following()
            except StopIteration:
                return
            yield item


def parts_of(path: Path) -> PartTimes:
    """Replay a room once, and return what its parts took [s]."""
    parts = PartTimes()
    timeline = path.with_suffix(".rrd")
    timeline.unlink(missing_ok=True)
    origin = Provenance(path.name, "", 0, 0, "")
    results = ResultsSink(path.with_suffix(".results"), origin, force=True)
    sinks = {"results": results, "timeline": RerunSink(timeline)}
    began = time.process_time()
    with Recording.open(path) as recording:
        pipeline = build_pipeline(load_pipeline(PIPELINE), recording.geometry)
        for stage in pipeline.stages:
            parts.wrap(stage.name, stage, "process_all", "flush", "buffer")
        for name, sink in sinks.items():
            parts.wrap(name, sink, "open", "write", "close")
        times = (recording.start_ns, recording.end_ns)
        site = (recording.streams, recording.geometry, ())  # labels are read apart
        session = ReplaySession(path.name, "room", *times, *site, pipeline.recipe())
        for sink in sinks.values():
            sink.open(session)
        replay(parts.read(Source(recording)), pipeline, list(sinks.values()))
        for sink in sinks.values():
            sink.close()
    total_s = time.process_time() - began
    parts["passing on, and set-up"] = total_s - parts.total()
    parts["whole"] = total_s
    return parts


def print_parts(path: Path, seconds: float, runs: int) -> None:
    """The least CPU time of each part."""
    parts_of(path)
    timings = [parts_of(path) for _ in range(runs)]
    print(f"{'one core, least CPU time':28}{'ms per s':>9}")
    for part in timings[0]:
        print(f"{part:28}{1e3 * min(each[part] for each in timings) / seconds:9.2f}")


def clocked_s(command: Sequence[str | Path]) -> float:
    """Return how long a process takes by the clock [s]."""
    began = time.perf_counter()
    subprocess.run(list(map(str, command)), check=True, capture_output=True)
    return time.perf_counter() - began


def print_processes(path: Path, seconds: float, runs: int) -> None:
    """The command against the script, by the clock."""
    seed = path.with_suffix(".mseed")
    write_miniseed(samples_of(path), seed)
    main = [sys.executable, "-c", "from groundtrace.cli.main import main; main()"]
    out = ["--out", path.with_suffix(".results"), "--force", "--no-viewer"]
    commands: dict[str, list[str | Path]] = {
        "ObsPy's script": [sys.executable, "-c", SCRIPT, seed],
        "replay to steps": [*main, "replay", path, "--pipeline", "room-steps", *out],
        "replay with places": [*main, "replay", path, "--pipeline", PIPELINE, *out],
    }
    took: dict[str, list[float]] = {name: [] for name in commands}
    for turn in range(runs + 1):
        for name, command in commands.items():
            taken = clocked_s(command)
            took[name] += [taken] if turn else []
    peer = min(took["ObsPy's script"])
    print(f"\n{f'{seconds:g} s, whole process':28}{'s':>9}{'x ObsPy':>9}")
    for name, times in took.items():
        print(f"{name:28}{min(times):9.2f}{peer / min(times):9.2f}")


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--long", action="store_true", help="and ten minutes, by the clock")
    options = parser.parse_args()
    alone()
    with tempfile.TemporaryDirectory() as folder:
        path = room(Path(folder) / "room.mcap", options.seconds)
        print(f"{CHANNELS} channels x {RATE_HZ:g} Hz, {options.seconds:g} s, through {PIPELINE}")
        print_processes(path, options.seconds, options.runs)
        if options.long:
            print_processes(room(Path(folder) / "long.mcap", 600.0), 600.0, 2)
        on_one_core()
        print()
        print_parts(path, options.seconds, options.runs)


if __name__ == "__main__":
    main()
