"""Replays of recordings that are still being written, or come through a pipe."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from command_runs import assert_same_decisions, done, run

from groundtrace.pipeline.results import (
    ResultsSink,
    file_sha256,
    provenance_of,
    read_results,
)
from groundtrace_codecs import live
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import Channel, SignalBlock, Stream
from groundtrace_codecs.writer import RecordingWriter
from groundtrace_recordings import path_of

if TYPE_CHECKING:
    from groundtrace_codecs.events import Event

Capture = pytest.CaptureFixture[str]
ROOM, WALK = path_of("room-walk.mcap"), path_of("waist-walk.mcap")
#: Copies a file as a logger writes it: so many bytes at a time, with a pause after each.
LOGGER = """
import sys, time
source, target, size, pause_s = sys.argv[1:]
with open(source, "rb") as whole, open(target, "ab", buffering=0) as growing:
    while piece := whole.read(int(size)):
        growing.write(piece)
        time.sleep(float(pause_s))
"""


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def logger(source: Path, target: str, size: int, pause_s: float) -> subprocess.Popen[bytes]:
    """Begin to write a recording in another process."""
    Path(target).touch()
    return subprocess.Popen(
        [sys.executable, "-c", LOGGER, str(source), target, str(size), str(pause_s)]
    )


def command(*arguments: object, **options: int) -> subprocess.Popen[str]:
    """Begin a command in a process of its own."""
    stalled = "from groundtrace_codecs.mcap import follow; follow.STALL_S = 0.5"
    code = f"{stalled}; from groundtrace.cli.main import main; main()"
    call = [sys.executable, "-c", code, *map(str, arguments)]
    return subprocess.Popen(
        call, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options
    )


@pytest.mark.parametrize(
    ("recording", "pipeline"), [(ROOM, "room-footsteps"), (WALK, "pedestrian")]
)
def test_a_file_followed_to_its_end_gives_what_the_finished_one_gives(
    recording: Path, pipeline: str, capsys: Capture
) -> None:
    with logger(recording, "rec.mcap", 30_011, 0.01) as writer:
        ran = done(capsys, "replay", "rec.mcap", "--follow", "--no-viewer", "--pipeline", pipeline)
    assert writer.returncode == 0
    assert ran.err.splitlines()[0].startswith("following rec.mcap (Ctrl-C ends it")
    done(capsys, "replay", "rec.mcap", "--no-viewer", "--pipeline", pipeline, "--out", "whole.mcap")
    assert_same_decisions(Path("rec.results.mcap"), Path("whole.mcap"))
    early, whole = provenance_of(Path("rec.results.mcap")), provenance_of(Path("whole.mcap"))
    assert (early.sha256, early.start_ns, early.end_ns) == (
        whole.sha256,
        whole.start_ns,
        whole.end_ns,
    )
    assert done(capsys, "score", "rec.results.mcap").out == done(capsys, "score", "whole.mcap").out


def test_standard_input_gives_what_the_file_gives(capsys: Capture) -> None:
    with ROOM.open("rb") as piped:
        replay = command("replay", "-", "--no-viewer", stdin=piped.fileno())
        out, err = replay.communicate()
    assert replay.returncode == 0, err
    assert out.endswith("results: stdin.results.mcap\n")
    done(capsys, "replay", ROOM, "--no-viewer", "--out", "whole.mcap")
    assert_same_decisions(Path("stdin.results.mcap"), Path("whole.mcap"))
    assert provenance_of(Path("stdin.results.mcap")).sha256 == file_sha256(ROOM)


@pytest.mark.parametrize("stop", [signal.SIGINT, signal.SIGTERM])
def test_a_stop_keeps_what_was_decided(stop: signal.Signals, capsys: Capture) -> None:
    shutil.copyfile(ROOM, "rec.mcap")
    os.truncate("rec.mcap", 1_000_000)  # as far as a logger came
    replay = command("replay", "rec.mcap", "--follow", "--no-viewer")
    assert replay.stderr is not None
    while "for 0.5 s; still waiting" not in replay.stderr.readline():
        assert replay.poll() is None
    replay.send_signal(stop)
    out, err = replay.communicate()
    assert replay.returncode == 0, err
    assert out.endswith("results: rec.results.mcap\n")
    done(capsys, "replay", "rec.mcap", "--no-viewer", "--out", "whole.mcap", losses=True)
    assert_same_decisions(Path("rec.results.mcap"), Path("whole.mcap"))
    early, whole = provenance_of(Path("rec.results.mcap")), provenance_of(Path("whole.mcap"))
    assert (early.sha256, early.end_ns) == (whole.sha256, whole.end_ns)
    assert read_results(Path("rec.results.mcap")).labels  # the truth that was there at its start


def test_a_stop_as_the_recording_ends_leaves_nothing_of_it_out(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copyfile(ROOM, "rec.mcap")
    write, asked = ResultsSink.write, []

    def pressed(sink: ResultsSink, item: SignalBlock | Event) -> None:
        write(sink, item)
        if not asked:  # the file is whole, and hardly any of it was replayed
            asked.append(True)
            os.kill(os.getpid(), signal.SIGINT)

    with monkeypatch.context() as patched:
        patched.setattr(ResultsSink, "write", pressed)
        done(capsys, "replay", "rec.mcap", "--follow", "--no-viewer")
    assert asked
    done(capsys, "replay", "rec.mcap", "--no-viewer", "--out", "whole.mcap")
    assert_same_decisions(Path("rec.results.mcap"), Path("whole.mcap"))
    assert provenance_of(Path("rec.results.mcap")).sha256 == file_sha256(ROOM)


@pytest.mark.sweep
def test_our_own_writer_is_followed_before_the_file_has_its_name(capsys: Capture) -> None:
    with Recording.open(WALK) as opened:
        streams = opened.streams
        blocks = [block for _, block in opened.blocks()]
    with RecordingWriter(Path("rec.mcap")) as writer:
        for stream in streams:
            writer.add_stream(stream)
        for block in blocks[: len(blocks) // 2]:
            writer.write(block)
        writer.flush()
        replay = command("replay", "rec.mcap", "--follow", "--no-viewer")
        assert replay.stderr is not None
        assert replay.stderr.readline().startswith("following rec.mcap")
        for block in blocks[len(blocks) // 2 :]:
            writer.write(block)
    out, err = replay.communicate()
    assert replay.returncode == 0, err
    assert out.startswith("replayed 60.0 s of ")
    done(capsys, "replay", "rec.mcap", "--no-viewer", "--out", "whole.mcap")
    assert_same_decisions(Path("rec.results.mcap"), Path("whole.mcap"))


def test_a_topic_that_begins_late_is_left_out_and_said(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live, "_HEAD_BYTES", 50_000)
    slow = Stream("/temperature", (Channel("t", "temperature", "K"),), 1.0)
    with Recording.open(WALK) as opened, RecordingWriter(Path("rec.mcap")) as writer:
        for stream in opened.streams:
            writer.add_stream(stream)
        blocks = [block for _, block in opened.blocks()]
        for block in blocks[: len(blocks) // 2]:
            writer.write(block)
        writer.flush()
        writer.add_stream(slow)
        for block in blocks[len(blocks) // 2 :]:
            writer.write(block)
        writer.write(SignalBlock(slow, blocks[-1].start_ns, 0, np.array([[290.0], [291.0]])))
    ran = done(capsys, "replay", "rec.mcap", "--follow", "--no-viewer")
    assert "rec.mcap: /temperature begins after the replay and is left out" in ran.err


@pytest.mark.parametrize(
    "option", [("--rate", "1"), ("--strict",), ("--at-miss", "1"), ("--to", "2")]
)
def test_what_needs_a_whole_recording_is_refused(option: tuple[str, ...], capsys: Capture) -> None:
    ran = run(capsys, "replay", "rec.mcap", "--follow", *option)
    assert (ran.code, ran.out) == (2, "")
    refused = "--follow: expected a recording, and no --from, --to, --rate, --strict or --at-miss"
    assert refused in ran.err


def test_a_file_that_is_not_there_is_named_as_it_was_asked_for(capsys: Capture) -> None:
    ran = run(capsys, "replay", "rec.mcap", "--follow")
    assert ran.code == 1
    assert "groundtrace: rec.mcap: expected a recording, found no such file" in ran.err


def test_what_is_no_recording_is_said_at_once(capsys: Capture) -> None:
    Path("rec.mcap").write_text("time,x\n0,1\n")
    ran = run(capsys, "replay", "rec.mcap", "--follow")
    assert ran.code == 1
    assert "expected the MCAP magic" in ran.err
