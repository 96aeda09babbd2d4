"""Annotations: labels that people add and change, each with an id, and the sidecar file of them.

A sidecar is an MCAP file beside a recording, ``REC.annotations.mcap`` beside ``REC.mcap``. Its
metadata name the recording by file name and SHA-256.
"""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING

from .errors import CodecError, SchemaError
from .events import Label  # noqa: TC001 (journals are decoded by these annotations)
from .schemas.event_messages import decode_label, label_channels, label_message
from .schemas.protobuf import message_class, parse

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from .mcap.reader import McapFile

#: Topic of annotations, in a sidecar or in a recording.
ANNOTATIONS_TOPIC = "/annotations"
#: Name of the metadata record that makes a file a sidecar.
SIDECAR = "groundtrace.annotations"
VERSION = "1"
_INT64_LIMIT = 1 << 63


@dataclass(frozen=True, slots=True)
class Annotation:
    """One annotation.

    Attributes
    ----------
    id
        Short and unique among the annotations of a recording.
    label
        What is said, when, and by whom.
    created_ns, edited_ns
        Wall clock of whoever annotated [ns since 1970].
    """

    id: str
    label: Label
    created_ns: int
    edited_ns: int


@dataclass(frozen=True, slots=True)
class RecordingKey:
    """Which recording annotations belong to.

    Attributes
    ----------
    name
        File name.
    sha256
        Of its bytes, hexadecimal.
    start_ns
        Its first sample [ns].
    """

    name: str
    sha256: str
    start_ns: int


@dataclass(frozen=True, slots=True)
class Sidecar:
    """What a sidecar holds.

    Attributes
    ----------
    key
        The recording it belongs to.
    annotations
        By time.
    journal
        Id of the journal that it was written from.
    actions
        How many of the journal's actions are in it.
    """

    key: RecordingKey
    annotations: tuple[Annotation, ...]
    journal: str
    actions: int

    def metadata(self) -> dict[str, str]:
        """Return what the metadata record :data:`SIDECAR` says of it."""
        return {
            "version": VERSION,
            "recording": self.key.name,
            "sha256": self.key.sha256,
            "start_ns": str(self.key.start_ns),
            "journal": self.journal,
            "actions": str(self.actions),
        }


def sidecar_path(recording: Path) -> Path:
    """Return where the annotations of a recording are."""
    return recording.with_name(f"{recording.stem}.annotations.mcap")


def journal_of(sidecar: Path) -> Path:
    """Return where the journal of a sidecar is."""
    return sidecar.with_suffix(".journal")


def annotated(recording: Path) -> bool:
    """Whether anything lies beside a recording that holds annotations of it."""
    sidecar = sidecar_path(recording)
    return sidecar.is_file() or journal_of(sidecar).is_file()


def in_order(annotations: Iterable[Annotation]) -> tuple[Annotation, ...]:
    """Return annotations by time; those of one time by their ids."""
    return tuple(sorted(annotations, key=lambda a: (a.label.time_ns, a.id)))


def encode_annotation(annotation: Annotation) -> bytes:
    """Encode one annotation: a label with an id."""
    message = label_message(annotation.label)
    message.id = annotation.id
    message.created_ns = annotation.created_ns
    message.edited_ns = annotation.edited_ns
    encoded: bytes = message.SerializeToString()
    return encoded


def decode_annotation(data: bytes | memoryview, where: str = "Label") -> Annotation:
    """Decode one annotation.

    Raises
    ------
    SchemaError
        Where the bytes are not a label, or it has no id; names ``where``.
    """
    label = decode_label(data, where)
    message = parse(message_class("Label"), data, where)
    if not message.id:
        raise SchemaError(f"{where}: expected an annotation with an id, found none")
    return Annotation(message.id, label, message.created_ns, message.edited_ns)


def annotations_of(file: McapFile) -> tuple[Annotation, ...]:
    """Return the annotations in a file, by time.

    Raises
    ------
    SchemaError
        Where a message there is not an annotation.
    """
    wanted = label_channels(file, ANNOTATIONS_TOPIC)
    if not wanted:
        return ()
    where = f"{file.name}: {ANNOTATIONS_TOPIC}"
    return in_order(decode_annotation(m.data, where) for m in file.messages(wanted))


def is_sidecar(file: McapFile) -> bool:
    """Whether a file says that it is a sidecar."""
    return any(record.name == SIDECAR for record in file.metadata)


def read_sidecar(path: Path) -> Sidecar:
    """Read a sidecar.

    Raises
    ------
    SchemaError
        Where the file is another kind of MCAP, or damaged.
    CodecError
        Where it cannot be read.
    """
    from .mcap.reader import McapFile

    try:
        file = McapFile.open(path)
    except OSError as error:
        raise CodecError(f"{path.name}: expected annotations, found: {error.strerror}") from error
    try:
        values = {
            k: v
            for record in file.metadata
            if record.name == SIDECAR
            for k, v in record.values.items()
        }
        annotations = annotations_of(file)
        if file.damage:
            damage = file.damage[0].reason
            raise SchemaError(f"{path.name}: expected an undamaged sidecar, found {damage}")
    finally:
        file.close()
    if not values:
        raise SchemaError(
            f"{path.name}: metadata: expected {SIDECAR}, as groundtrace annotate writes it, "
            "found none"
        )
    if values.get("version") != VERSION:
        raise SchemaError(
            f"{path.name}: version: expected {VERSION}, found {values.get('version')!r}"
        )
    key = RecordingKey(
        values.get("recording", ""), values.get("sha256", ""), _number(values, "start_ns", path)
    )
    return Sidecar(key, annotations, values.get("journal", ""), _number(values, "actions", path))


def _number(values: dict[str, str], name: str, path: Path) -> int:
    text = values.get(name, "")
    if not (text.isascii() and text.isdecimal() and len(text) < 20) or int(text) >= _INT64_LIMIT:
        raise SchemaError(f"{path.name}: {name}: expected a whole number, found {text[:40]!r}")
    return int(text)


def replace_durably(fresh: Path, path: Path) -> None:
    """Give a written file its name only when its bytes are on the disk, and the name too."""
    with fresh.open("rb") as file:
        os.fsync(file.fileno())
    fresh.replace(path)
    if sys.platform == "win32":  # it has no folders to open, and keeps names by itself
        return
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)
