"""Checkpoints: what is refused before anything of it is decoded."""

from __future__ import annotations

import os
import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from groundtrace.checkpoint import (
    MAGIC,
    Checkpoint,
    Origin,
    key_path,
    read_checkpoint,
    write_checkpoint,
)
from groundtrace.engine import Tally
from groundtrace.errors import CheckpointError
from groundtrace.results import Provenance
from groundtrace_codecs.continuing import Settled

ORIGIN = Origin(Provenance("r.mcap", "ab" * 32, 1, 9, "[recipe]", versions={"numpy": "2"}), "", 5)


@pytest.fixture(autouse=True)
def _settings_of_their_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "settings"))
    monkeypatch.setenv("APPDATA", str(tmp_path / "settings"))


def checkpoint(state: Any = None) -> Checkpoint:
    kept = Settled("r.mcap.partial", 10, 0, ())
    return Checkpoint(ORIGIN, 7, kept, Tally(samples=3), (), None, {}, (state,))


@pytest.fixture
def path(tmp_path: Path) -> Path:
    written = tmp_path / "r.mcap.checkpoint"
    write_checkpoint(written, checkpoint())
    return written


class Dangerous:
    """Does harm when it is unpickled."""

    def __init__(self, harm: Path) -> None:
        self.harm = harm

    def __reduce__(self) -> tuple[object, ...]:
        return (Path.touch, (self.harm,))


def test_a_checkpoint_is_read_as_it_was_written(path: Path) -> None:
    found = read_checkpoint(path, ORIGIN)
    assert (found.origin, found.reached_ns, found.tally.samples) == (ORIGIN, 7, 3)
    assert found.kept == checkpoint().kept


@pytest.mark.parametrize(
    ("other", "said"),
    [
        (replace(ORIGIN, site="x"), "geometry"),
        (replace(ORIGIN, block_ns=0), "--rate"),
        (replace(ORIGIN, provenance=replace(ORIGIN.provenance, sha256="cd")), "sha256"),
        (replace(ORIGIN, provenance=replace(ORIGIN.provenance, pipeline="x")), "pipeline or para"),
        (replace(ORIGIN, provenance=replace(ORIGIN.provenance, to_ns=5)), "to_ns"),
        (replace(ORIGIN, provenance=replace(ORIGIN.provenance, versions={})), "versions"),
    ],
)
def test_a_checkpoint_of_something_else_is_refused(path: Path, other: Origin, said: str) -> None:
    with pytest.raises(CheckpointError, match=f"of this replay, found other {said}"):
        read_checkpoint(path, other)


def test_other_arguments_are_no_other_replay(path: Path) -> None:
    again = replace(ORIGIN.provenance, arguments=("replay", "--no-viewer"))
    assert read_checkpoint(path, replace(ORIGIN, provenance=again)).origin == ORIGIN


def test_a_byte_changed_anywhere_is_refused(path: Path) -> None:
    content = path.read_bytes()
    for place in range(len(content)):
        path.write_bytes(content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :])
        with pytest.raises(CheckpointError):
            read_checkpoint(path, ORIGIN)
    for cut in range(0, len(content), 7):
        path.write_bytes(content[:cut])
        with pytest.raises(CheckpointError):
            read_checkpoint(path, ORIGIN)


def test_what_another_key_signed_is_never_unpickled(path: Path, tmp_path: Path) -> None:
    write_checkpoint(path, checkpoint(Dangerous(tmp_path / "harm")))
    key_path().unlink()
    with pytest.raises(CheckpointError, match="expected the signature of this user's key"):
        read_checkpoint(path, ORIGIN)
    path.write_bytes(MAGIC + bytes(32) + pickle.dumps(Dangerous(tmp_path / "harm")))
    with pytest.raises(CheckpointError, match="expected the signature of this user's key"):
        read_checkpoint(path, ORIGIN)
    assert not (tmp_path / "harm").exists()


def test_no_checkpoint_and_another_file_are_said(path: Path) -> None:
    path.write_bytes(b"x")
    with pytest.raises(CheckpointError, match="expected a checkpoint, found something else"):
        read_checkpoint(path, ORIGIN)
    path.unlink()
    with pytest.raises(CheckpointError, match="expected a checkpoint, found: No such file"):
        read_checkpoint(path, ORIGIN)


def test_a_state_that_cannot_be_pickled_leaves_the_checkpoint_before(path: Path) -> None:
    before = path.read_bytes()
    with pytest.raises(CheckpointError, match="expected stages whose state can be kept"):
        write_checkpoint(path, checkpoint(lambda: None))
    assert path.read_bytes() == before


@pytest.mark.skipif(os.name != "posix", reason="modes are those of POSIX")
def test_the_key_is_for_its_owner_alone(path: Path) -> None:
    assert key_path().stat().st_mode & 0o777 == 0o600
    key_path().chmod(0o644)
    with pytest.raises(CheckpointError, match="expected a key that only its owner can read"):
        read_checkpoint(path, ORIGIN)
