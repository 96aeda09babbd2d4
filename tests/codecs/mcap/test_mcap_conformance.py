"""The conformance files of the MCAP project: every combination of optional parts."""

from __future__ import annotations

import json
from collections import Counter
from typing import TYPE_CHECKING, Any

import pytest

from groundtrace_codecs.mcap.reader import McapFile

if TYPE_CHECKING:
    from pathlib import Path

FILES = 416


@pytest.fixture(scope="module")
def conformance(data: Path) -> list[Path]:
    folder = data / "mcap-conformance"
    if not folder.is_dir():
        pytest.skip("the MCAP conformance files are absent from the recordings folder")
    return sorted(folder.rglob("*.mcap"))


def expected_records(path: Path) -> dict[str, list[dict[str, Any]]]:
    document = json.loads(path.with_suffix(".json").read_text())
    found: dict[str, list[dict[str, Any]]] = {}
    for entry in document["records"]:
        found.setdefault(entry["type"], []).append(dict(entry["fields"]))
    return found


def as_bytes(numbers: list[str]) -> bytes:
    return bytes(map(int, numbers))


def check_messages(file: McapFile, expected: dict[str, list[dict[str, Any]]]) -> None:
    rows = [
        (
            int(m["channel_id"]),
            int(m["sequence"]),
            int(m["log_time"]),
            int(m["publish_time"]),
            as_bytes(m["data"]),
        )
        for m in expected.get("Message", [])
    ]
    rows.sort(key=lambda row: (row[2], row[0], row[1]))
    assert [(*m[:4], bytes(m.data)) for m in file.messages()] == rows
    assert file.message_counts == Counter(row[0] for row in rows)
    assert (file.start_ns, file.end_ns) == ((rows[0][2], rows[-1][2]) if rows else (0, 0))


def check_definitions(file: McapFile, expected: dict[str, list[dict[str, Any]]]) -> None:
    assert {s.id: (s.name, s.encoding, s.data) for s in file.schemas.values()} == {
        int(s["id"]): (s["name"], s["encoding"], as_bytes(s["data"]))
        for s in expected.get("Schema", [])
    }
    assert {
        c.id: (c.topic, c.schema_id, c.message_encoding, c.metadata) for c in file.channels.values()
    } == {
        int(c["id"]): (c["topic"], int(c["schema_id"]), c["message_encoding"], c["metadata"])
        for c in expected.get("Channel", [])
    }


def check_extras(file: McapFile, expected: dict[str, list[dict[str, Any]]]) -> None:
    assert [
        (a.name, a.media_type, a.log_time, a.create_time, a.size, file.attachment(a))
        for a in file.attachments
    ] == [
        (
            a["name"],
            a["media_type"],
            int(a["log_time"]),
            int(a["create_time"]),
            len(a["data"]),
            as_bytes(a["data"]),
        )
        for a in expected.get("Attachment", [])
    ]
    assert [(m.name, m.values) for m in file.metadata] == [
        (m["name"], m["metadata"]) for m in expected.get("Metadata", [])
    ]
    (header,) = expected["Header"]
    assert (file.profile, file.library) == (header["profile"], header["library"])


def check_statistics(file: McapFile, expected: dict[str, list[dict[str, Any]]]) -> None:
    for stated in expected.get("Statistics", []):
        assert sum(file.message_counts.values()) == int(stated["message_count"])
        assert len(file.channels) == int(stated["channel_count"])
        assert len(file.schemas) == int(stated["schema_count"])
        assert len(file.attachments) == int(stated["attachment_count"])
        assert len(file.metadata) == int(stated["metadata_count"])
        assert {str(k): str(v) for k, v in file.message_counts.items()} == stated[
            "channel_message_counts"
        ]


def test_every_conformance_file_reads_as_its_description_says(conformance: list[Path]) -> None:
    assert len(conformance) == FILES
    for path in conformance:
        expected = expected_records(path)
        with McapFile.open(path, strict=True) as file:
            check_messages(file, expected)
            check_definitions(file, expected)
            check_extras(file, expected)
            check_statistics(file, expected)
            assert file.damage == (), path.name
