"""A minute of 16 channels at 20 kHz, followed while another process writes it: docs/live.md.

The writer is the package ``mcap``, not ours. Of each way it may fail a replay with ``--follow`` is
run as a command, and its decisions are compared with those of a replay of what the file then is:

- late: messages are dropped, and written 60 ms too late;
- torn: the writer is killed inside a chunk, then the replay is stopped by Ctrl-C;
- stalled: the writer stops for 15 s, and goes on;
- replaced: another file takes the name.

Run: python bench/live_minute.py [late torn stalled replaced]
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap.writer import Writer

from groundtrace.pipeline.results import read_results
from groundtrace.pipeline.split import same_events

WAYS = ("late", "torn", "stalled", "replaced")
#: Seconds of the recording that are written, of each way but the first.
SHORT_S = 22.0
#: Parts of the messages that are dropped, and that are late by so much [s].
DROPPED, LATE, LATE_S = 0.005, 0.015, 0.06
MAIN = "from groundtrace.cli.main import main; main()"


def write(source: Path, target: Path, way: str) -> None:
    """Write a recording in real time as a logger does, and fail in one way."""
    chance = random.Random(1)
    with source.open("rb") as stream, target.open("wb") as out:
        reader = make_reader(stream)
        writer = Writer(out, chunk_size=1 << 14)
        writer.start()
        for metadata in reader.iter_metadata():
            writer.add_metadata(metadata.name, metadata.metadata)
        for attachment in reader.iter_attachments():
            times = attachment.create_time, attachment.log_time
            writer.add_attachment(*times, attachment.name, attachment.media_type, attachment.data)
        channels: dict[int, int] = {}
        waiting: list[tuple[float, int, Any]] = []
        began, first_ns, dropped = time.time(), None, 0
        for schema, channel, message in reader.iter_messages():
            first_ns = first_ns or message.log_time
            at_s = (message.log_time - first_ns) / 1e9
            if way != "late" and at_s > SHORT_S:
                break
            if channel.id not in channels:
                kind = writer.register_schema(schema.name, schema.encoding, schema.data)
                channel_fields = channel.topic, channel.message_encoding, kind, channel.metadata
                channels[channel.id] = writer.register_channel(*channel_fields)
            if began + at_s > time.time():
                out.flush()
                time.sleep(max(0.0, began + at_s - time.time()))
            drawn = chance.random() if way == "late" and channel.topic == "/seismic" else 1.0
            if drawn < DROPPED:
                dropped += 1
                continue
            waiting.append((at_s + LATE_S * (drawn < DROPPED + LATE), channel.id, message))
            for one in [one for one in waiting if one[0] <= at_s]:
                waiting.remove(one)
                add(writer, channels[one[1]], one[2])
        for _, number, message in waiting:
            add(writer, channels[number], message)
        if way == "torn":
            out.flush()
            out.write(
                b"\x06" + (1 << 20).to_bytes(8, "little") + bytes(1000)
            )  # a chunk that begins
            out.flush()
            os.kill(os.getpid(), signal.SIGKILL)
        writer.finish()
    print(f"dropped {dropped} messages")


def add(writer: Writer, channel: int, message: Any) -> None:
    """Write a message as it was."""
    times = message.log_time, message.data, message.publish_time, message.sequence
    writer.add_message(channel, *times)


def followed(source: Path, target: Path, way: str) -> str:
    """Follow a writer that fails in one way; return what was said of it."""
    logger = subprocess.Popen([sys.executable, __file__, "--write", source, target, way])
    while not target.exists() or not target.stat().st_size:
        time.sleep(0.02)
    replay = subprocess.Popen(
        [*command(target, "live"), "--follow"], stderr=subprocess.PIPE, text=True
    )
    if way == "stalled":
        time.sleep(SHORT_S / 3)
        logger.send_signal(signal.SIGSTOP)
        time.sleep(15)
        logger.send_signal(signal.SIGCONT)
    if way == "replaced":
        time.sleep(SHORT_S / 2)
        target.rename(target.with_name("before.mcap"))
        target.write_bytes(source.read_bytes())
    logger.wait()
    ended = time.time()
    if way == "torn":
        time.sleep(8)
        replay.send_signal(signal.SIGINT)
    stderr_text = replay.communicate()[1]
    return (
        f"{stderr_text}ended {time.time() - ended:.1f} s after the writer, "
        f"with code {replay.returncode}"
    )


def command(recording: Path, name: str) -> list[str]:
    """Return the command that replays a recording into results of a name."""
    out = recording.with_name(f"{name}.results.mcap")
    call = [sys.executable, "-c", MAIN, "replay", str(recording), "--pipeline", "room-footsteps"]
    return [*call, "--no-viewer", "--quiet", "--force", "--out", str(out)]


def main() -> None:
    """Print what was said, and whether the results are those of the file as it is then."""
    if sys.argv[1:2] == ["--write"]:
        write(Path(sys.argv[2]), Path(sys.argv[3]), sys.argv[4])
        return
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder, "source.mcap")
        room = ["--channels", "16", "--duration-s", "60", "--seed", "3"]
        call = [sys.executable, "-c", MAIN, "simulate", "room", "-o", str(source), *room]
        subprocess.run(call, check=True, capture_output=True)
        for way in sys.argv[1:] or WAYS:
            target = Path(folder, f"{way}.mcap")
            print(f"{way}: {followed(source, target, way)}", flush=True)
            live = read_results(Path(folder, "live.results.mcap")).events
            if way == "replaced":  # the file that was followed has no name any more
                print(f"{way}: {len(live)} events are kept\n", flush=True)
                continue
            subprocess.run(command(target, "again"), check=False, capture_output=True)
            same = same_events(live, read_results(Path(folder, "again.results.mcap")).events)
            print(f"{way}: {'the same decisions' if same else 'OTHER DECISIONS'}\n", flush=True)


if __name__ == "__main__":
    main()
