"""Chunks read ahead are those that are read when they are due, and damage is told as ever."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from groundtrace_codecs import cores
from groundtrace_codecs.mcap import McapFile
from groundtrace_codecs.signals import Channel, SignalBlock, Stream
from groundtrace_codecs.writer import write_recording

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Some five chunks."""
    stream = Stream("/s", tuple(Channel(f"G{i}", "seismic", "count") for i in (1, 2)), 40_000.0)
    noise = np.random.default_rng(1).integers(-9000, 9000, (30, 40_000, 2)).astype(np.int16)
    blocks = [SignalBlock(stream, 10**18, i * 40_000, part) for i, part in enumerate(noise)]
    found = tmp_path / "noise.mcap"
    write_recording(found, [(stream, "i16le", blocks)])
    return found


def _messages(path: Path) -> tuple[list[bytes], tuple[str, ...]]:
    with McapFile.open(path) as file:
        assert len(file._chunks) > 4
        (channel,) = (c.id for c in file.channels.values() if c.topic == "/s")
        found = [bytes(m.data) for m in file.messages({channel})]
        return found, tuple(d.reason for d in file.damage)


def test_messages_and_damage_are_the_same_on_one_core_and_on_two(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with McapFile.open(path) as file:
        middle = file._chunks[3]
    spoilt = bytearray(path.read_bytes())
    spoilt[middle.offset + middle.length // 2] ^= 0xFF
    bad = path.with_name("bad.mcap")
    bad.write_bytes(spoilt)
    found = {}
    for count in (1, 2):
        monkeypatch.setattr(cores, "cores", lambda count=count: count)
        found[count] = (_messages(path), _messages(bad))
    assert found[1] == found[2]
    (whole, none), (part, damage) = found[1]
    assert len(whole) == 300
    assert not none
    assert 0 < len(part) < 300
    assert len(damage) == 1
