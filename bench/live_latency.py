"""How long after it is written a recording's signal, steps and places are there: docs/live.md.

A logger in another process writes 16 channels at 20 kHz in real time, a chunk every 0.1 s; a replay
follows its file. Latency is measured from the moment that a chunk is in the file: to the replay's
sinks, and with ``--browser`` to the page in headless Chromium: the time of its picture, and the
rows of its list. Beside it the memory of the replay.

Run: python bench/live_latency.py [--seconds 60] [--speed 1] [--browser]
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import tempfile
import threading
import time
from bisect import bisect_left
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np

from groundtrace.api.replay import PlannedReplay, configured_for, growing
from groundtrace.cli.main import main as groundtrace
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S
from groundtrace_codecs.writer import RecordingWriter

CHUNK_S = 0.1
#: What a page shows: the time of its picture, how long the replay is, the rows of its list.
SEEN = """() => [document.querySelector("#time").value,
    document.querySelector("#duration").textContent,
    [...document.querySelectorAll("#events li .t")].map((row) => row.textContent)]"""
MAIN = "from groundtrace.cli.main import main; main()"


def write(source: Path, target: Path, speed: float) -> None:
    """Write a recording as a logger does; print when each end of a chunk was in the file."""
    flushes = []
    with Recording.open(source) as opened, RecordingWriter(target) as writer:
        if opened.geometry is not None:
            writer.set_geometry(opened.geometry)
        for stream in opened.streams:
            writer.add_stream(stream)
        began, start_ns = time.time(), opened.start_ns
        flushed_ns = start_ns
        for _, block in opened.blocks():
            writer.write(block)
            if block.end_ns - flushed_ns >= CHUNK_S * NS_PER_S:
                flushed_ns = block.end_ns
                deadline_s = began + (flushed_ns - start_ns) / NS_PER_S / speed
                time.sleep(max(0.0, deadline_s - time.time()))
                writer.flush()
                flushes.append((flushed_ns, time.time()))
    print(json.dumps(flushes))


class Clocked:
    """A sink that notes when everything comes."""

    def __init__(self) -> None:
        self.came: defaultdict[str, list[tuple[int, float]]] = defaultdict(list)

    def open(self, session: object) -> None:
        """Begin."""

    def write(self, item: Any) -> None:
        """Take an item."""
        time_ns = item.end_ns if hasattr(item, "samples") else getattr(item, "time_ns", [])
        if np.ndim(time_ns) == 0:
            self.came[type(item).__name__].append((int(time_ns), time.time()))

    def close(self) -> None:
        """End."""


def told(came: list[tuple[int, float]], written: list[tuple[int, float]]) -> str:
    """Return median and 95 % of how long after its chunk was written something came."""
    ends = [end_ns for end_ns, _ in written]
    late = []
    for time_ns, wall in came:
        at = bisect_left(ends, time_ns)
        if at < len(ends):
            late.append(wall - written[at][1])
    if not late:
        return "none"
    median, most = np.percentile(late, (50, 95))
    return f"median {median:.2f} s, 95 % {most:.2f} s ({len(late)})"


def memory_mb(pid: int | str) -> float:
    """Return the resident memory of a process [MB]; Linux."""
    text = Path(f"/proc/{pid}/status").read_text()
    return int(re.findall(r"VmRSS:\s+(\d+)", text)[0]) / 1024


def in_process(target: Path) -> dict[str, list[tuple[int, float]]]:
    """Follow a file into a sink; return when everything came."""
    sink = Clocked()
    with growing(target, threading.Event(), print) as live:
        ready = configured_for(live.head, None, ())
        PlannedReplay.of(live.head, target, ready, live=live).run([sink])
    print(f"memory of the replay at its end: {memory_mb('self'):.0f} MB")
    return sink.came


def in_browser(target: Path) -> dict[str, list[tuple[int, float]]]:
    """Follow a file with --web; return when the page's picture and its list had what came."""
    from playwright.sync_api import Error, sync_playwright

    call = [sys.executable, "-c", MAIN, "replay", str(target), "--follow", "--web", "--force"]
    came: defaultdict[str, list[tuple[int, float]]] = defaultdict(list)
    rows: set[str] = set()
    log_path = target.with_name("said.txt")
    with (
        log_path.open("w") as stream,
        subprocess.Popen(call, stderr=stream, stdout=stream, cwd=target.parent) as replay,
    ):
        while (match := re.search(r"serving (\S+)", log_path.read_text())) is None:
            time.sleep(0.05)
        url = match[1]
        with sync_playwright() as play:
            flags = ["--no-sandbox", "--disable-dev-shm-usage", "--enable-unsafe-swiftshader"]
            browser = play.chromium.launch(executable_path="/usr/bin/chromium", args=flags)
            page = browser.new_page(viewport={"width": 800, "height": 480})
            page.add_init_script("console.debug = () => {}")  # the viewer says very much
            page.goto(url)
            with Recording.open(target.with_name("source.mcap")) as source:
                start_ns = source.start_ns
            while True:
                try:
                    seen = page.evaluate(SEEN)
                except Error:
                    continue
                now = time.time()

                shown_ns = start_ns + round(float(seen[0] or 0) * NS_PER_S)
                if not came["picture"] or came["picture"][-1][0] != shown_ns:
                    came["picture"].append((shown_ns, now))
                for row in set(seen[2]) - rows:
                    came["list of steps"].append((start_ns + round(float(row) * NS_PER_S), now))
                rows |= set(seen[2])
                if seen[1] and "live" not in seen[1]:
                    break
                time.sleep(0.05)
            browser.close()
        print(f"memory of the replay at its end: {memory_mb(replay.pid):.0f} MB")
        while replay.poll() is None:  # the first one may still end the recording alone
            replay.terminate()
            time.sleep(0.5)
    return came


def main() -> None:
    """Print the latencies."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--seconds", type=float, default=60.0)
    options.add_argument("--speed", type=float, default=1.0)
    options.add_argument("--browser", action="store_true")
    options.add_argument("--write", nargs=2, type=Path, help=argparse.SUPPRESS)
    asked = options.parse_args()
    if asked.write:
        write(*asked.write, asked.speed)
        return
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "source.mcap", Path(folder) / "live.mcap"
        room = ["--channels", "16", "--duration-s", str(asked.seconds), "--seed", "3"]
        groundtrace(["simulate", "room", "-o", str(source), *room])
        call = [sys.executable, __file__, "--write", str(source), str(target)]
        call += ["--speed", str(asked.speed)]
        with subprocess.Popen(call, stdout=subprocess.PIPE, text=True) as logger:
            while not target.with_name("live.mcap.partial").exists():
                time.sleep(0.01)
            came = in_browser(target) if asked.browser else in_process(target)
            written = json.loads(logger.communicate()[0])
    for kind, seen in came.items():
        print(f"{kind}: {told(seen, written)}")


if __name__ == "__main__":
    main()
