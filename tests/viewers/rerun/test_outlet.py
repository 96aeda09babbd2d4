"""The viewer's file, with a pipe of ours and on a system that has none, while the disk fills."""

from __future__ import annotations

import shutil
import time
from collections import namedtuple
from typing import TYPE_CHECKING

import pytest
import rerun as rr

from groundtrace.errors import OutputError
from groundtrace_viewers.rerun import sink

if TYPE_CHECKING:
    from pathlib import Path

Usage = namedtuple("Usage", "total used free")


@pytest.fixture(params=[True, False], ids=["pipes", "none"])
def outlet(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(sink, "PIPES", request.param)
    recording = rr.RecordingStream("groundtrace_outlet")
    return recording, sink.Outlet(recording, tmp_path / "a.rrd.partial", name=tmp_path / "a.rrd")


def test_all_that_is_logged_is_in_the_file(outlet, tmp_path: Path) -> None:
    recording, made = outlet
    for k in range(50):
        recording.log(f"place/{k}", rr.TextLog("x"))
    made.finish()
    content = (tmp_path / "a.rrd.partial").read_bytes()
    assert content.startswith(b"RRF2")
    assert len(content) > 5000


def test_without_pipes_a_file_is_given_up_while_the_disk_has_some_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    free = [10**9, 10**9, 10**7]
    monkeypatch.setattr(sink, "PIPES", False)
    monkeypatch.setattr(sink, "_LOOK_S", 0.01)
    used = lambda _: Usage(10**9, 0, free.pop(0) if len(free) > 1 else free[0])  # noqa: E731
    monkeypatch.setattr(shutil, "disk_usage", used)
    recording = rr.RecordingStream("groundtrace_outlet")
    made = sink.Outlet(recording, tmp_path / "a.rrd.partial", name=tmp_path / "a.rrd")
    recording.log("before", rr.TextLog("x"))
    time.sleep(0.2)
    size = (tmp_path / "a.rrd.partial").stat().st_size
    for _ in range(200):
        recording.log("after", rr.TextLog("x" * 10_000))
    recording.flush()
    assert (tmp_path / "a.rrd.partial").stat().st_size == size
    with pytest.raises(OutputError, match=r"a.rrd: expected room to write, found: No space left"):
        made.finish()
    assert not (tmp_path / "a.rrd.partial").exists()
