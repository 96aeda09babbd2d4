"""Memory of a long replay that is watched while it is followed, and of its viewer: docs/live.md.

A recording of 16 channels at 20 kHz is followed with ``--spawn``, as fast as it goes, into a viewer
without a screen. Linux: memory is read from /proc.

Run: python bench/live_memory.py [--minutes 60]
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

from live_latency import memory_mb

from groundtrace.api.replay import PlannedReplay, configured_for, growing
from groundtrace.pipeline.plugins import load
from groundtrace.pipeline.results import ResultsSink
from groundtrace_codecs.signals import NS_PER_S
from groundtrace_viewers.rerun import sink as viewer_sink
from groundtrace_viewers.rerun.process import open_viewer

ROWS = 12


def without_screen(arguments: list[str], port: int) -> subprocess.Popen[bytes]:
    """Start the viewer where there is no display."""
    return open_viewer(["--headless", "--window-size", "1280x720", *arguments], port)


def main() -> None:
    """Print the memory of both as the replay goes on."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--minutes", type=int, default=60)
    asked = options.parse_args()
    viewer_sink.open_viewer = without_screen
    with tempfile.TemporaryDirectory() as folder:
        recording = Path(folder) / "long.mcap"
        made = [sys.executable, str(Path(__file__).with_name("big_recording.py")), str(recording)]
        subprocess.run([*made, "--minutes", str(asked.minutes)], check=True, stdout=sys.stderr)
        with growing(recording, threading.Event(), print) as live:
            ready = configured_for(live.head, None, ())
            plan = PlannedReplay.of(live.head, recording, ready, live=live)
            shown = load("sinks", "rerun")(None, spawn=True)
            results_sink = ResultsSink(Path(folder) / "results.mcap", plan.provenance())
            ended = threading.Event()

            def told() -> None:
                began, next_s = time.monotonic(), 0.0
                print("recorded [min]  replay [MB]  viewer [MB]  times real time")
                while not ended.wait(0.5):
                    at_s = (live.end_ns - live.head.start_ns) / NS_PER_S
                    if at_s >= next_s and shown.viewer is not None:
                        next_s += asked.minutes * 60 / ROWS
                        pids = ("self", shown.viewer.pid)
                        mine, others = (f"{memory_mb(pid):11.0f}" for pid in pids)
                        speed = at_s / (time.monotonic() - began)
                        print(f"{at_s / 60:14.1f}  {mine}  {others}  {speed:.1f}", flush=True)

            teller = threading.Thread(target=told)
            teller.start()
            try:
                plan.run([results_sink, shown])
            finally:
                ended.set()
                teller.join()
                if shown.viewer is not None:
                    shown.viewer.kill()


if __name__ == "__main__":
    main()
