"""``groundtrace doctor``: what can be read, what is missing, a sound copy, and the installation."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import time
from collections import Counter
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from command_runs import check_schema, done, run
from mcap.reader import make_reader
from mcap.writer import Writer

from groundtrace.api import doctor as examined
from groundtrace_codecs.mcap.reader import McapFile
from groundtrace_codecs.mcap.writer import CHUNK_BYTES
from groundtrace_recordings import path_of

if TYPE_CHECKING:
    from collections.abc import Callable

TOPICS = {"/seismic": 260, "/seismic/envelope": 1300, "/tf_static": 1, "/truth": 201}
LIMIT = 400_000


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def health(capsys: pytest.CaptureFixture[str], *arguments: object) -> dict[str, Any]:
    """Run doctor on a recording; return what its document says of it."""
    document = done(capsys, "doctor", *arguments, "--json").document
    check_schema("doctor", document)
    assert document["installation"] is None
    found: dict[str, Any] = document["recording"]
    return found


def room_walk() -> bytes:
    return path_of("room-walk.mcap").read_bytes()


def chunk_flipped() -> bytes:
    data = bytearray(room_walk())
    data[len(data) // 2] ^= 4
    return bytes(data)


def contents(path: Path) -> Counter[tuple[str, int, int, int, bytes]]:
    with McapFile.open(path) as file:
        return Counter(
            (file.channels[m.channel_id].topic, *m[1:4], bytes(m.data)) for m in file.messages()
        )


def test_a_sound_recording_is_said_to_be_sound(capsys: pytest.CaptureFixture[str]) -> None:
    found = health(capsys, path_of("room-walk.mcap"))
    assert found["sound"]
    assert found["indexed"]
    assert {t["topic"]: t["messages"] for t in found["topics"]} == TOPICS
    assert (found["damage"], found["lost"], found["signals"]) == ([], 0, None)


def test_a_damaged_chunk_is_named_with_bytes_messages_and_span(
    capsys: pytest.CaptureFixture[str],
) -> None:
    Path("flip.mcap").write_bytes(chunk_flipped())
    found = health(capsys, "flip.mcap")
    (place,) = found["damage"]
    assert place["offset"] < len(chunk_flipped()) // 2 < place["offset"] + place["length"]
    assert place["messages"] == found["lost"] == 1762 - found["messages"] > 0
    assert 0 < place["start_s"] < place["end_s"] < 15
    assert not found["sound"]
    said = done(capsys, "doctor", "flip.mcap").out
    assert f"{place['messages']} messages lost, {place['start_s']:.3f} to" in said


def test_strict_stops_at_the_first_damage_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    Path("flip.mcap").write_bytes(chunk_flipped())
    for arguments in (("doctor", "flip.mcap"), ("replay", "flip.mcap", "--no-viewer")):
        error = run(capsys, *arguments, "--strict").error
        assert error.startswith("flip.mcap: byte ")
        assert "expected chunk CRC" in error
    assert not Path("flip.results.mcap").exists()


def test_what_is_no_recording_is_refused_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    Path("text.mcap").write_text("nothing of the kind", "utf-8")
    assert "expected the MCAP magic" in run(capsys, "doctor", "text.mcap").error
    assert "no such file" in run(capsys, "doctor", "none.mcap").error
    assert "expected a recording" in run(capsys, "doctor", "--repair", "out.mcap").error


@pytest.mark.parametrize(
    "spoil",
    [
        room_walk,
        chunk_flipped,
        lambda: room_walk()[: 2 * len(room_walk()) // 3],
        lambda: bytes(4096) + room_walk()[4096:],
        lambda: room_walk() + path_of("waist-walk.mcap").read_bytes(),
    ],
    ids=["sound", "flipped", "cut", "first page zeroed", "two files"],
)
def test_a_repaired_copy_is_sound_and_holds_all_that_was_readable(
    spoil: Callable[[], bytes], capsys: pytest.CaptureFixture[str]
) -> None:
    Path("in.mcap").write_bytes(spoil())
    before = health(capsys, "in.mcap", "--repair", "out.mcap")
    assert before["repair"] == {
        "path": "out.mcap",
        "messages": before["messages"],
        "left_out": [a["fault"] for a in before["attachments"] if a["fault"]],
    }
    after = health(capsys, "out.mcap")
    assert after["sound"], after
    assert after["indexed"]
    assert contents(Path("out.mcap")) == contents(Path("in.mcap"))
    with Path("out.mcap").open("rb") as stream:
        rows = list(make_reader(stream, validate_crcs=True).iter_messages())
    assert len(rows) == before["messages"] > 1000
    assert "expected a new file" in run(capsys, "doctor", "in.mcap", "--repair", "out.mcap").error
    assert "the one that is read" in run(capsys, "doctor", "in.mcap", "--repair", "in.mcap").error


def test_repair_keeps_everything_that_is_no_message(capsys: pytest.CaptureFixture[str]) -> None:
    with Path("in.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "other tool")
        writer.register_schema("Unused", "jsonschema", b"{}")
        schema = writer.register_schema("Used", "jsonschema", b"{}")
        channel = writer.register_channel("/a", "json", schema, {"unit": "m"})
        writer.register_channel("/silent", "json", 0)
        writer.add_attachment(3, 4, "good.txt", "text/plain", b"good")
        writer.add_attachment(5, 6, "bad.txt", "text/plain", b"a text to be hurt")
        writer.add_metadata("session", {"site": "lab"})
        writer.add_message(channel, 10, b"{}", 9, 8)
        writer.finish()
    Path("in.mcap").write_bytes(Path("in.mcap").read_bytes().replace(b"to be hurt", b"to be h!rt"))
    found = health(capsys, "in.mcap", "--repair", "out.mcap")
    assert len(found["repair"]["left_out"]) == 1
    assert [a["fault"] is None for a in found["attachments"]] == [True, False]
    with McapFile.open("in.mcap") as before, McapFile.open("out.mcap", strict=True) as after:
        assert after.profile == "ros2"
        assert after.schemas == before.schemas
        assert after.channels == before.channels
        assert after.metadata == before.metadata
        (ref,) = after.attachments
        assert (ref.name, ref.media_type, ref.create_time, ref.log_time) == (
            "good.txt",
            "text/plain",
            3,
            4,
        )
        assert [(*m[:4], bytes(m.data)) for m in after.messages()] == [(1, 8, 10, 9, b"{}")]


def command(*arguments: str) -> list[str]:
    return [sys.executable, "-c", "from groundtrace.cli.main import main; main()", *arguments]


CSV_MAP = """
format = "csv"
time = {column = "t", unit = "s"}
[[stream]]
topic = "/imu/waist"
columns = [{column = "az", quantity = "acceleration", axis = "z", unit = "g"}]
"""


def table() -> tuple[str, ...]:
    """Write a table that takes long to import; return what imports it."""
    rows = [f"{i / 1000},{i * 7919 % 9973 / 9973}" for i in range(200_000)]
    Path("walk.csv").write_text("\n".join(["t,az", *rows]), "utf-8")
    Path("map.toml").write_text(CSV_MAP, "utf-8")
    return ("import", "walk.csv", "-o", "new.mcap", "--map", "map.toml")


def long_walk() -> tuple[str, ...]:
    """Write a recording whose results are several chunks long; return what replays it."""
    made = command("simulate", "room", "-o", "walk.mcap", "--steps", "100")
    subprocess.run(made, stdout=subprocess.DEVNULL, check=True)
    return ("replay", "walk.mcap", "--out", "new.mcap", "--no-viewer")


@pytest.mark.parametrize(
    ("begun", "enough"),
    [
        (lambda: ("simulate", "room", "-o", "new.mcap", "--steps", "200"), 2_000_000),
        pytest.param(table, 200_000, marks=pytest.mark.sweep),
        pytest.param(long_walk, 30_000, marks=pytest.mark.sweep),
    ],
    ids=["simulate", "import", "replay"],
)
def test_a_killed_run_leaves_a_file_that_is_brought_back_but_for_its_last_chunk(
    begun: Callable[[], tuple[str, ...]], enough: int, capsys: pytest.CaptureFixture[str]
) -> None:
    partial = Path("new.mcap.partial")
    with subprocess.Popen(command(*begun()), stdout=subprocess.DEVNULL) as process:
        deadline = time.monotonic() + 100
        while not (partial.exists() and partial.stat().st_size > enough):
            assert process.poll() is None, "ended before it could be killed"
            assert time.monotonic() < deadline
            time.sleep(0.002)
        process.send_signal(signal.SIGKILL)
    assert not Path("new.mcap").exists()
    found = health(capsys, partial, "--repair", "new.mcap")
    assert found["messages"] > 100
    torn = [d for d in found["damage"] if d["length"]]
    # all that is on disk is read, but for the chunk that was being written
    assert sum(d["length"] for d in torn) < CHUNK_BYTES
    assert all(d["offset"] + d["length"] == found["bytes"] for d in torn)
    assert partial.stat().st_size == found["bytes"]
    assert health(capsys, "new.mcap")["sound"]


def limited() -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (LIMIT, LIMIT))


def test_a_full_disk_is_one_line_and_what_was_written_is_kept(
    capsys: pytest.CaptureFixture[str],
) -> None:
    ran = subprocess.run(
        command("simulate", "room", "-o", "room.mcap", "--steps", "40"),
        preexec_fn=limited,
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    assert ran.returncode == 1
    (line,) = ran.stderr.splitlines()
    assert line.startswith("groundtrace: room.mcap: expected room to write, found: File too large")
    assert line.endswith("groundtrace doctor room.mcap.partial --repair room.mcap")
    assert not Path("room.mcap").exists()
    assert Path("room.mcap.partial").stat().st_size == LIMIT
    found = health(capsys, "room.mcap.partial", "--repair", "room.mcap")
    assert found["messages"] > 100
    assert health(capsys, "room.mcap")["sound"]


def test_the_installation_is_told_with_what_would_install_the_rest(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = examined._version
    monkeypatch.setattr(examined, "_version", lambda n: None if n == "obspy" else whole(n))
    document = done(capsys, "doctor", "--json").document
    check_schema("doctor", document)
    found = document["installation"]
    assert document["recording"] is None
    assert found["sound"]
    assert {p["name"]: p["version"] for p in found["packages"]}["numpy"] == version("numpy")
    assert found["viewer"]["version"].startswith("rerun")
    assert found["broken_plugins"] == []
    (obspy,) = [e for e in found["extras"] if e["package"] == "obspy"]
    assert obspy["command"] == "pip install 'groundtrace[seismic]'"
    monkeypatch.setattr(examined, "_version", lambda n: None if n == "numpy" else whole(n))
    said = done(capsys, "doctor").out
    assert "MISSING" in said
    assert "something needed is missing" in said
