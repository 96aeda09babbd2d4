"""Size of a timeline and what the viewer takes to show it, for each way of ``--full-rate``.

A simulated walk on a floor is replayed once for each; sizes are compared with the raw samples of
16 bits. Then the viewer opens each file without a screen; its own profile says how long it works
on a frame. It draws on the processor here, and other programs slow it down.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import load_pipeline, with_settings
from groundtrace.pipeline.engine import ReplaySession, replay
from groundtrace.pipeline.source import Source
from groundtrace.simulate.recording import write
from groundtrace.simulate.room import simulate_room
from groundtrace.simulate.room_plan import RoomOptions
from groundtrace_codecs.recording import Recording
from groundtrace_viewers import RerunSink
from groundtrace_viewers.rerun.capture import wait_for_recording
from groundtrace_viewers.rerun.process import (
    connect,
    free_port,
    quiet_environment,
    start_viewer,
    viewer_program,
)
from groundtrace_viewers.rerun.timeline import TIMELINE

if TYPE_CHECKING:
    from rerun.experimental import ViewerClient

RAW_BYTES = 2
FRAMES = 20
#: The viewer greets, loads and caches for so long before it is measured [s].
SETTLE_S, SEEK_S = 8.0, 3.0


@dataclass(frozen=True, slots=True)
class Shown:
    """What the viewer took: to open, to its first picture [s], and for frames [ms]."""

    open_s: float
    picture_s: float
    frames_ms: tuple[float, ...]


def written_s(path: Path, rrd: Path, full_rate: str, settings: list[str]) -> float:
    """Write a timeline; return the wall time of the replay."""
    began = time.perf_counter()
    with Recording.open(path) as recording:
        config = with_settings(load_pipeline("room-footsteps"), settings)
        chain = build_pipeline(config, recording.geometry, recording.labels)
        source = Source(recording)
        session = ReplaySession(
            path.name,
            config.application,
            recording.start_ns,
            recording.end_ns,
            source.streams,
            recording.geometry,
            recording.labels,
            chain.recipe(),
        )
        sink = RerunSink(rrd, full_rate=full_rate)
        sink.open(session)
        replay(source, chain, [sink])
        sink.close()
    return time.perf_counter() - began


def shown(rrd: Path, at_s: list[float]) -> Shown:
    """Open a timeline and measure it with the cursor at some times."""
    port = free_port()
    began = time.perf_counter()
    window = ["--headless", "--window-size", "1600x900", "--hide-welcome-screen"]
    process = start_viewer([*window, str(rrd)], port)
    try:
        client = connect(process, port)
        wait_for_recording(client, rrd)
        opened = time.perf_counter() - began
        client.take_screenshot()
        picture = time.perf_counter() - began
        time.sleep(SETTLE_S)
        frames = [frame_ms(client, at) for at in at_s]
    finally:
        process.terminate()
        process.wait(10)
    return Shown(opened, picture, tuple(frames))


def frame_ms(client: ViewerClient, at_s: float) -> float:
    """Put the cursor somewhere; return the median time the viewer works on a frame [ms]."""
    client.set_time(TIMELINE, duration=at_s, play_state="paused")
    time.sleep(SEEK_S)
    with tempfile.TemporaryDirectory() as folder:
        trace = Path(folder) / "trace.puffin"
        client.capture_profile_trace(str(trace), num_frames=FRAMES)
        command = [str(viewer_program()), "dump-puffin", str(trace)]
        dump = subprocess.run(command, env=quiet_environment(), capture_output=True, check=True)
    return statistics.median(f["duration_ns"] / 1e6 for f in json.loads(dump.stdout)["frames"])


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recording", type=Path, nargs="?", help="of a room; without it a simulated")
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--channels", type=int, default=16)
    parser.add_argument("--set", action="append", default=[], help="stage.parameter=value")
    parser.add_argument("--full-rate", nargs="+", default=["none", "misses", "events"])
    options = parser.parse_args()
    print(f"{'--full-rate':12}{'MB':>8}{'% of raw':>10}{'written s':>11}{'open s':>8}", end="")
    print(f"{'picture s':>11}   ms per frame, cursor at the start, middle, end")
    with tempfile.TemporaryDirectory() as folder:
        path = options.recording or Path(folder) / "room.mcap"
        if options.recording is None:
            room = RoomOptions(duration_s=options.seconds, channels=options.channels)
            write(simulate_room(room), path)
        with Recording.open(path) as recording:
            (stream,) = recording.streams
            length_s = (recording.end_ns - recording.start_ns) / 1e9
        raw = RAW_BYTES * len(stream.channels) * stream.rate_hz * length_s
        for mode in options.full_rate:
            rrd = Path(folder) / f"{mode}.rrd"
            wall_s = written_s(path, rrd, mode, options.set)
            size = rrd.stat().st_size
            timing = shown(rrd, [min(5.0, length_s / 4), length_s / 2, length_s - 5.0])
            frames = "  ".join(f"{ms:5.1f}" for ms in timing.frames_ms)
            print(
                f"{mode:12}{size / 1e6:8.1f}{100 * size / raw:10.2f}{wall_s:11.1f}"
                f"{timing.open_s:8.2f}{timing.picture_s:11.2f}   {frames}"
            )


if __name__ == "__main__":
    main()
