"""Checkpoints: where a replay stands, on the disk, so that it can go on after it was broken off.

The state of detectors, filters and trackers is a pickle, which must never be read from a stranger:
a file is signed with a key of this user's (HMAC-SHA-256), and what was signed with another one is
refused before anything of it is decoded. A checkpoint of other versions, another recording or other
parameters is refused too: going on from it would mix two replays.
"""

from __future__ import annotations

import hashlib
import hmac
import os
import pickle
import secrets
import stat
import sys
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from .errors import CheckpointError
from .results import Provenance

if TYPE_CHECKING:
    from groundtrace_codecs.continuing import Settled
    from groundtrace_codecs.mcap import Damage

    from .engine import Tally

MAGIC = b"groundtrace checkpoint 1\n"
_KEY_BYTES = _SIGNATURE_BYTES = 32


@dataclass(frozen=True, slots=True)
class Origin:
    """What a replay that goes on must have in common with the one that was broken off.

    Attributes
    ----------
    provenance
        Recording, pipeline, versions, span; its arguments are those of the first command.
    site
        SHA-256 of the geometry in use; empty without one.
    block_ns
        Length to which blocks are joined [ns]; 0 where the replay is paced.
    """

    provenance: Provenance
    site: str
    block_ns: int

    def difference(self, other: Origin) -> str:
        """Say what another origin has that differs; empty where nothing does."""
        one, two = self.provenance, other.provenance
        for name in (f for f in Provenance.__dataclass_fields__ if f != "arguments"):
            if getattr(one, name) != getattr(two, name):
                return "pipeline or parameters" if name == "pipeline" else name
        if self.site != other.site:
            return "geometry"
        return "" if self.block_ns == other.block_ns else "--rate"


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """Everything that a replay needs to go on.

    Attributes
    ----------
    origin
        What is replayed, and through what.
    reached_ns
        Up to where signals were replayed [ns].
    kept
        How much of the results is whole.
    tally
        What was produced so far.
    damage
        What of the recording was left out so far.
    source, watches, stages
        State of the source, of the watches of placements and of worn sensors, and of every stage.
    """

    origin: Origin
    reached_ns: int
    kept: Settled
    tally: Tally
    damage: tuple[Damage, ...]
    source: Any
    watches: Any
    stages: tuple[Any, ...]


def checkpoint_path(results: Path) -> Path:
    """Return where the checkpoint of a replay is: beside its results."""
    return results.with_name(f"{results.name}.checkpoint")


def write_checkpoint(path: Path, checkpoint: Checkpoint) -> None:
    """Write a checkpoint; the file there before stays until the new one is whole.

    Raises
    ------
    CheckpointError
        Where a stage's state cannot be pickled, or there is no place for the file or the key.
    """
    header = msgspec.json.encode(checkpoint.origin)
    try:
        state = pickle.dumps(checkpoint, pickle.HIGHEST_PROTOCOL)
        body = len(header).to_bytes(8, "little") + header + state
        fresh = path.with_name(f"{path.name}.new")
        fresh.write_bytes(MAGIC + _signature(_key(), body) + body)
        fresh.replace(path)
    except OSError as error:
        raise CheckpointError(
            f"{path}: expected room for a checkpoint, found: {error.strerror}"
        ) from error
    except (pickle.PicklingError, TypeError, AttributeError) as error:
        raise CheckpointError(
            f"{path}: expected stages whose state can be kept, found: {error}"
        ) from error


def read_checkpoint(path: Path, origin: Origin) -> Checkpoint:
    """Read a checkpoint that belongs to a replay.

    Raises
    ------
    CheckpointError
        Where there is none, it was signed by somebody else or changed since, or ``origin`` differs.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise CheckpointError(f"{path}: expected a checkpoint, found: {error.strerror}") from error
    if not content.startswith(MAGIC):
        raise CheckpointError(f"{path}: expected a checkpoint, found something else")
    signature = content[len(MAGIC) : len(MAGIC) + _SIGNATURE_BYTES]
    body = content[len(MAGIC) + _SIGNATURE_BYTES :]
    if not hmac.compare_digest(signature, _signature(_key(), body)):
        raise CheckpointError(f"{path}: expected the signature of this user's key, found another")
    size = int.from_bytes(body[:8], "little")
    written = msgspec.json.decode(body[8 : 8 + size], type=Origin)
    if what := written.difference(origin):
        raise CheckpointError(f"{path}: expected a checkpoint of this replay, found other {what}")
    # signed by this user, of these very versions
    checkpoint: Checkpoint = pickle.loads(body[8 + size :])
    return replace(checkpoint, origin=written)


def remove_checkpoint(path: Path) -> None:
    """Remove a checkpoint, if there is one."""
    with suppress(FileNotFoundError):
        path.unlink()


def key_path() -> Path:
    """Return where this user's key is: ``groundtrace/checkpoint.key`` among the user's settings."""
    if sys.platform == "win32":
        base = os.environ.get("APPDATA", "")
    else:
        base = os.environ.get("XDG_CONFIG_HOME", "")
    root = Path(base) if base else Path("~/.config").expanduser()
    return root / "groundtrace" / "checkpoint.key"


def _signature(key: bytes, body: bytes) -> bytes:
    return hmac.new(key, MAGIC + body, hashlib.sha256).digest()


def _key() -> bytes:
    """Return this user's key; made where there is none, refused where others can read it."""
    path = key_path()
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    with suppress(FileExistsError):
        made = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(made, "wb") as file:
            file.write(secrets.token_bytes(_KEY_BYTES))
    if os.name == "posix" and stat.S_IMODE(path.stat().st_mode) & 0o077:
        raise CheckpointError(f"{path}: expected a key that only its owner can read; see chmod 600")
    key = path.read_bytes()
    if len(key) != _KEY_BYTES:
        raise CheckpointError(f"{path}: expected {_KEY_BYTES} bytes, found {len(key)}; remove it")
    return key
