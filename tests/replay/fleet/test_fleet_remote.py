"""Recordings behind URLs: read in ranges, without a copy, as if they were here."""

from __future__ import annotations

import hashlib
import re
import time
import tracemalloc
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from command_runs import assert_same_decisions, check_schema, done, run
from fleet_runs import Here, ran_fleet, use
from pyarrow import parquet
from served_room import ROOM, Ranges, served_room

from groundtrace.fleet.run import lost, name_of, recipes_of, recordings_of, tasks_of
from groundtrace.fleet.table import decoded
from groundtrace.pipeline.results import provenance_of
from groundtrace_codecs import CodecError, Recording
from groundtrace_codecs.location import Location, as_url, is_url
from groundtrace_codecs.mcap.byte_source import BLOCK_BYTES, RemoteBytes
from groundtrace_codecs.signals import Channel, SignalBlock, Stream
from groundtrace_codecs.writer import write_recording
from groundtrace_recordings import path_of

if TYPE_CHECKING:
    from collections.abc import Iterator

fsspec = pytest.importorskip("fsspec", reason="fsspec is not installed: groundtrace[fleet]")
pytest.importorskip("aiohttp", reason="aiohttp is not installed: groundtrace[fleet]")
Capture = pytest.CaptureFixture[str]


@pytest.fixture
def served(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Serve the bundled room; yield its URL."""
    monkeypatch.setattr(Ranges, "sent", 0)
    with served_room() as port:
        yield f"http://127.0.0.1:{port}/data/room-walk.mcap"


@pytest.fixture
def memory() -> Iterator[Any]:
    """An empty file system of fsspec in memory."""
    system = fsspec.filesystem("memory")
    yield system
    system.store.clear()


def test_every_read_gives_the_bytes_of_the_file_and_its_hash(memory: Any) -> None:
    data = hashlib.shake_256(b"some bytes").digest(5 * BLOCK_BYTES + 123)
    memory.pipe("/a.bin", data)
    source = RemoteBytes("memory://a.bin")
    size = len(data)
    spans = [(size - 10, 100), (0, 8), (BLOCK_BYTES - 3, 7), (0, size), (size, 5), (3, 0)]
    for offset, length in [*spans, (4 * BLOCK_BYTES + 1, BLOCK_BYTES)]:
        assert source.read_at(offset, length) == data[offset : offset + length]
    assert source.sha256() == hashlib.sha256(data).hexdigest()


def test_the_hash_costs_no_second_reading(memory: Any) -> None:
    memory.pipe("/room.mcap", ROOM)
    source = RemoteBytes("memory://room.mcap")
    with Recording.open(source) as recording:
        blocks = sum(1 for _ in recording.blocks())
        assert source.sha256() == hashlib.sha256(ROOM).hexdigest()
    assert blocks > 0
    assert len(ROOM) <= source.fetched_bytes < len(ROOM) + 2 * BLOCK_BYTES
    assert source.requests < len(ROOM) / BLOCK_BYTES


def test_what_was_closed_is_read_and_hashed_anew(served: str) -> None:
    source = RemoteBytes(served)
    with Recording.open(source) as recording:
        assert recording.streams  # its index, and no more
    assert source.read_at(100, 50) == ROOM[100:150]
    source.close()
    source.close()
    assert source.sha256() == hashlib.sha256(ROOM).hexdigest()


def test_info_of_a_url_fetches_a_part_of_it(served: str, capsys: Capture) -> None:
    said = done(capsys, "info", served, "--json").document
    check_schema("info", said)
    assert said["bytes"] == len(ROOM)
    assert said["streams"]
    assert said["truth"]["label"] > 0
    assert 0 < Ranges.sent < 0.6 * len(ROOM)


def test_replay_of_a_url_is_the_replay_of_its_file(
    served: str, capsys: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    options = ("--no-viewer", "--json")
    remote = done(capsys, "replay", served, *options, "--out", "remote.mcap").document
    assert len(ROOM) <= Ranges.sent < 1.1 * len(ROOM), "each byte is fetched once"
    local = done(capsys, "replay", path_of("room-walk.mcap"), *options, "--out", "local.mcap")
    assert remote["samples"] == local.document["samples"]
    assert remote["recording"] == local.document["recording"] == "room-walk.mcap"
    one, other = (provenance_of(tmp_path / name) for name in ("remote.mcap", "local.mcap"))
    assert one.sha256 == other.sha256 == hashlib.sha256(ROOM).hexdigest()
    assert_same_decisions(tmp_path / "remote.mcap", tmp_path / "local.mcap")


def test_a_span_of_a_url_fetches_itself_and_its_warm_up_alone(
    memory: Any, capsys: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    rng, rate = np.random.default_rng(1), 20_000
    channels = tuple(Channel(f"G{i}", "ground_velocity", "m/s") for i in range(8))
    stream = Stream("/seismic", channels, float(rate))
    noise = rng.integers(-30_000, 30_000, (60 * rate, 8)).astype(np.int16)
    write_recording("noise.mcap", [(stream, "i16le", [SignalBlock(stream, 10**18, 0, noise)])])
    data = Path("noise.mcap").read_bytes()
    memory.pipe("/noise.mcap", data)
    fetched: list[int] = []
    ranged = RemoteBytes._range

    def counting(self: RemoteBytes, start: int, stop: int) -> bytes:
        fetched.append(stop - start)
        return ranged(self, start, stop)

    monkeypatch.setattr(RemoteBytes, "_range", counting)
    span = ("--pipeline", "signals", "--from", 30, "--to", 31, "--no-viewer")
    said = done(capsys, "replay", "memory://noise.mcap", *span, "--out", "a.mcap", "--json")
    assert said.document["samples"] == 8 * rate
    assert 0 < sum(fetched) < 0.35 * len(data)
    assert provenance_of(tmp_path / "a.mcap").sha256 == "", "most of it was not read"


def test_a_fleet_over_http_decides_what_it_decides_here(
    served: str, capsys: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, memory: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    use(monkeypatch, Here())
    memory.pipe("/fleet/room-walk.mcap", ROOM)
    memory.pipe("/fleet/room-walk.results.mcap", b"")
    places = (path_of("room-walk.mcap"), served, "memory://fleet", "memory://fleet/*.mcap")
    command = ("-o", "t.parquet", "--json", "--force", "--pipeline", "room-footsteps")
    reports = [done(capsys, "fleet", place, *command).document for place in places]
    assert {report["rows"] for report in reports} == {1}
    assert len({report["digest"] for report in reports}) == 1
    (row,) = parquet.read_table("t.parquet").to_pylist()
    assert row["location"] == "memory:///fleet/room-walk.mcap"
    assert row["sha256"] == hashlib.sha256(ROOM).hexdigest()
    again = done(capsys, "fleet", "memory://fleet", *command, "--resume").document
    assert again["known"] == 1


def test_what_cannot_be_reached_is_one_line(
    served: str, capsys: Capture, monkeypatch: pytest.MonkeyPatch, memory: Any
) -> None:
    monkeypatch.setattr(Ranges, "deaf", True)
    said = run(capsys, "info", served).error
    assert said.endswith("expected bytes to read, found: a server that gives no ranges")
    gone = run(capsys, "info", "memory://nowhere/walk.mcap").error
    assert gone == "memory://nowhere/walk.mcap: size: expected bytes to read, found: no such file"
    assert "expected a URL to read, found:" in run(capsys, "info", "nothing://a.mcap").error
    monkeypatch.setitem(__import__("sys").modules, "fsspec.core", None)
    said = run(capsys, "info", served).error
    assert said.endswith("install it with: pip install 'groundtrace[fleet]'")


def test_urls_are_told_from_paths_and_their_secrets_are_not_told() -> None:
    assert is_url("s3://bucket/walk.mcap")
    assert is_url("https:/host/walk.mcap")
    assert not is_url("C:/walk.mcap")
    assert not is_url("folder/walk.mcap")
    assert as_url("https:/host/a.mcap") == as_url("https://host/a.mcap") == "https://host/a.mcap"
    assert as_url("file:/tmp/a.mcap") == "file:///tmp/a.mcap"
    assert str(Location("https://me:word@host/a.mcap?key=1")) == "https://host/a.mcap"
    assert name_of(Location("https://host/b/other.mcap?key=1")) == "other.mcap"
    assert recordings_of(["https://host/c.mcap?key=*"]) == ["https://host/c.mcap"]


def test_a_folder_behind_a_url_that_holds_none_is_refused(memory: Any) -> None:
    memory.pipe("/empty/readme.txt", b"")
    with pytest.raises(Exception, match=r"memory://empty: expected a recording, a folder") as told:
        recordings_of(["memory://empty"])
    assert not isinstance(told.value, CodecError)


@pytest.fixture
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("groundtrace_codecs.mcap.byte_source.PAUSES_S", (0.0, 0.0))


@pytest.mark.usefixtures("at_once")
@pytest.mark.parametrize("failing", [[503], [500, 502], [0], [429, 0]])
def test_what_fails_now_and_then_is_asked_again(
    served: str, monkeypatch: pytest.MonkeyPatch, failing: list[int]
) -> None:
    source = RemoteBytes(served)
    monkeypatch.setattr(Ranges, "failing", list(failing))
    assert source.read_at(0, len(ROOM)) == ROOM
    assert Ranges.failing == []


@pytest.mark.usefixtures("at_once")
@pytest.mark.parametrize(
    ("status", "asked", "found"),
    [
        (403, 1, "no access (403)"),
        (401, 1, "no access (401)"),
        (404, 1, "no such file"),
        (500, 3, "a server that fails (500)"),
        (0, 3, "connection broken off"),
    ],
)
def test_each_failure_has_its_name(
    served: str, monkeypatch: pytest.MonkeyPatch, status: int, asked: int, found: str
) -> None:
    source = RemoteBytes(served)
    monkeypatch.setattr(Ranges, "failing", [status] * 9)
    with pytest.raises(CodecError, match=re.escape(f"expected bytes to read, found: {found}")):
        source.read_at(0, 100)
    # a client may ask once more by itself on a connection that was kept
    assert asked <= 9 - len(Ranges.failing) <= 2 * asked


@pytest.mark.usefixtures("at_once")
def test_nobody_there_is_refused() -> None:
    with pytest.raises(CodecError, match="size: expected bytes to read, found: connection refused"):
        RemoteBytes("http://127.0.0.1:9/a.mcap")


def test_a_server_without_ranges_is_told_before_its_file_is_in_memory(
    served: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Ranges, "deaf", True)
    source = RemoteBytes(served)
    tracemalloc.start()
    with pytest.raises(CodecError, match="found: a server that gives no ranges"):
        source.read_at(len(ROOM) - 100, 100)
    assert tracemalloc.get_traced_memory()[1] < len(ROOM) / 2
    tracemalloc.stop()


@pytest.mark.sweep
def test_a_server_that_comes_to_no_end_is_a_row_wherever_it_is_read(
    memory: Any, monkeypatch: pytest.MonkeyPatch, capsys: Capture, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    memory.pipe("/slow.mcap", ROOM)
    memory.pipe("/room.mcap", ROOM)
    read = RemoteBytes.read_at

    def endless(source: RemoteBytes, offset: int, length: int) -> bytes:
        while source.name.endswith("slow.mcap"):
            time.sleep(0.01)
        return read(source, offset, length)

    monkeypatch.setattr(RemoteBytes, "read_at", endless)
    use(monkeypatch, Here())
    command = ("memory://room.mcap", "memory://slow.mcap", "--pipeline", "room-steps")
    limited = (*command, "-o", "t.parquet", "--limit-s", "3")
    said = ran_fleet(capsys, *limited)
    assert (said["rows"], said["errors"]) == (2, 1)
    errors = parquet.read_table("t.parquet").column("error").to_pylist()
    assert errors == ["", "slow.mcap: expected a replay within 3 s, found none"]
    assert ran_fleet(capsys, *limited, "--join")["digest"] == said["digest"]


def test_of_a_lost_url_nothing_is_asked(memory: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    memory.pipe("/room.mcap", ROOM)
    monkeypatch.setattr(RemoteBytes, "__init__", lambda *_, **__: pytest.fail("asked"))
    recipes = recipes_of(["room-steps"], [], 0.12)
    (task,) = tasks_of([Location("memory://room.mcap")], recipes, 0.12, {})
    done = lost(task)
    part = decoded(done.data or b"")
    assert part is not None
    assert part.row.error == (
        "room.mcap: expected a worker that ends, found it killed twice, or overdue"
    )
