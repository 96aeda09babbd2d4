"""What is taken for something that nobody states is said by every command that reads it."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

import pytest
from command_runs import done
from mcap.writer import Writer

from groundtrace.pipeline.results import read_results
from groundtrace_codecs.events import Note

if TYPE_CHECKING:
    from pathlib import Path

START_NS = 1_700_000_000_000_000_000
DEFINITION = b"float64 lat\nfloat64 lon\nfloat64 alt\n"


@pytest.fixture
def rover(tmp_path: Path) -> Path:
    """Return an MCAP file of ROS 2 messages of a type that nobody else knows, one a second."""
    path = tmp_path / "rover.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        schema = writer.register_schema("rover_msgs/msg/Position", "ros2msg", DEFINITION)
        channel = writer.register_channel("/rover", "cdr", schema)
        for i in range(30):
            at_ns = START_NS + i * 10**9
            data = b"\x00\x01\x00\x00" + struct.pack("<3d", 48.0 + 1e-5 * i, 11.0, 500.0)
            writer.add_message(channel, at_ns, data, at_ns, i)
        writer.finish()
    return path


def test_a_position_of_an_unknown_type_is_told_by_import_info_and_replay(
    rover: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    said = (
        "/rover: the lat and lon of rover_msgs/Position, a message of unknown type, are taken for "
        "a position in degrees"
    )
    assert done(capsys, "info", rover, "--json").document["unit_warnings"] == [said]
    imported = done(capsys, "import", rover, "-o", "walk.mcap", "--json").document
    assert said in imported["warnings"]
    ran = done(capsys, "replay", rover, "--pipeline", "signals", "--no-viewer", "--out", "r.mcap")
    assert (ran.out + ran.err).count(said) == 1
    notes = [x for x in read_results(tmp_path / "r.mcap").events if isinstance(x, Note)]
    assert [(x.text, x.level, x.source) for x in notes] == [(said, "WARN", "recording")]
    ran = done(capsys, "replay", rover, "--pipeline", "signals", "--no-viewer", "--json", "--force")
    assert [x["text"] for x in ran.document["warnings"]] == [said]
