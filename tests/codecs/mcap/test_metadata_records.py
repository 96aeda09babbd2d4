"""A metadata record that was changed: its length and name are in the index, its bytes in a CRC."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from groundtrace_codecs.mcap.reader import McapFile
from groundtrace_recordings import path_of

if TYPE_CHECKING:
    from pathlib import Path

VALUE = b"start_ns"


@pytest.fixture
def data() -> bytearray:
    return bytearray(path_of("room-walk.mcap").read_bytes())


def reasons(path: Path, content: bytes) -> list[str]:
    path.write_bytes(content)
    with McapFile.open(path) as file:
        for _ in file.messages():
            pass
        file.check_data()
        return [damage.reason for damage in file.damage]


def test_a_sound_file_has_no_damage(data: bytearray, tmp_path: Path) -> None:
    assert reasons(tmp_path / "a.mcap", data) == []


def test_a_changed_value_is_damage(data: bytearray, tmp_path: Path) -> None:
    data[data.index(VALUE) + len(VALUE) + 5] ^= 1
    (found,) = reasons(tmp_path / "a.mcap", data)
    assert found.startswith("data section: expected CRC 0x")
    assert found.endswith("metadata, definitions or indexes were changed")


@pytest.mark.parametrize(("back", "name"), [(12, "length"), (-4, "name")])
def test_a_changed_length_or_name_is_damage(
    back: int, name: str, data: bytearray, tmp_path: Path
) -> None:
    at = data.rindex(b"recording", 0, data.index(VALUE))
    data[at - back] ^= 4
    found = reasons(tmp_path / "a.mcap", data)
    assert any(reason.startswith("metadata: expected 'recording' of 100 bytes") for reason in found)
