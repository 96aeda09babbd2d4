"""The journal: every action on annotations, one line of JSON each, on the disk before it counts."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import msgspec

from groundtrace_codecs.annotations import Annotation, RecordingKey, replace_durably

from ..errors import AnnotationError

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

FORMAT = "groundtrace-annotation-journal"
VERSION = 1


@dataclass(frozen=True, slots=True)
class Change:
    """What an action did to one annotation; None where it was not, or is no more.

    Attributes
    ----------
    before, after
        The annotation.
    """

    before: Annotation | None
    after: Annotation | None

    @property
    def id(self) -> str:
        """Id of the annotation."""
        kept = self.after or self.before
        return kept.id if kept is not None else ""

    @property
    def reversed(self) -> Change:
        """The change that takes this one back."""
        return Change(self.after, self.before)


@dataclass(frozen=True, slots=True)
class Action:
    """One action of one person.

    Attributes
    ----------
    action
        What was done.
    author
        Who did it.
    at_ns
        Wall clock [ns since 1970].
    changes
        What it did.
    undoes
        Of ``undo``: the number of the action taken back; the first has the number 1.
    """

    action: Literal["add", "edit", "delete", "merge", "undo"]
    author: str
    at_ns: int
    changes: tuple[Change, ...]
    undoes: int | None = None


@dataclass(frozen=True, slots=True)
class Header:
    """The first line of a journal.

    Attributes
    ----------
    format, version
        Of the journal.
    id
        Random; the sidecar written from a journal names it.
    recording
        What is annotated.
    base
        Annotations that were there before the first action.
    """

    format: str
    version: int
    id: str
    recording: RecordingKey
    base: tuple[Annotation, ...] = ()


@dataclass(frozen=True, slots=True)
class Journal:
    """A journal, read.

    Attributes
    ----------
    header
        Its first line.
    actions
        In the order they were done.
    length
        Bytes of the file up to the end of the last whole line.
    torn
        Whether more bytes follow, of an action that was never acknowledged.
    """

    header: Header
    actions: tuple[Action, ...]
    length: int
    torn: bool

    def items(self) -> dict[str, Annotation]:
        """Return the annotations after the last action, by id."""
        items = {a.id: a for a in self.header.base}
        for action in self.actions:
            apply(action.changes, items)
        return items

    def ids(self) -> set[str]:
        """Return every id that was ever given."""
        used = {a.id for a in self.header.base}
        return used | {change.id for action in self.actions for change in action.changes}

    def last_of(self, author: str) -> int | None:
        """Return the number of an author's last action that still stands, or None."""
        undone = {action.undoes for action in self.actions}
        for number in range(len(self.actions), 0, -1):
            action = self.actions[number - 1]
            if action.author == author and action.action != "undo" and number not in undone:
                return number
        return None


def apply(changes: Iterable[Change], items: dict[str, Annotation]) -> None:
    """Do changes to annotations."""
    for change in changes:
        if change.after is None:
            items.pop(change.id, None)
        else:
            items[change.id] = change.after


def read_journal(path: Path) -> Journal:
    """Read a journal; a torn last line, which nobody was told is safe, is left out.

    Raises
    ------
    AnnotationError
        Where it is not a journal, or a line before the last cannot be read.
    """
    content = path.read_bytes()
    whole = content[: content.rfind(b"\n") + 1]
    lines = whole.splitlines(keepends=True)
    header = _header(lines[0] if lines else b"", path.name)
    actions: list[Action] = []
    length = len(lines[0])
    for number, line in enumerate(lines[1:], 2):
        try:
            actions.append(msgspec.json.decode(line, type=Action))
        except (msgspec.DecodeError, UnicodeDecodeError) as error:
            if number == len(lines) and len(whole) == len(content):
                break
            place = f"{path.name}: line {number}"
            raise AnnotationError(f"{place}: expected an action, found: {error}") from error
        length += len(line)
    return Journal(header, tuple(actions), length, length < len(content))


def _header(line: bytes, name: str) -> Header:
    try:
        header = msgspec.json.decode(line, type=Header)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise AnnotationError(f"{name}: line 1: expected {FORMAT}, found: {error}") from error
    if (header.format, header.version) != (FORMAT, VERSION):
        raise AnnotationError(
            f"{name}: line 1: expected {FORMAT} {VERSION}, "
            f"found {header.format[:40]} {header.version}"
        )
    return header


class JournalWriter:
    """Appends actions to a journal.

    Parameters
    ----------
    path
        The file; made if it is not there.
    journal
        As it was read, or an empty one to begin with.
    """

    def __init__(self, path: Path, journal: Journal) -> None:
        if journal.length == 0:
            journal = _begun(path, journal)
        self.journal = journal
        self._file = os.open(path, os.O_WRONLY)
        if journal.torn:
            os.ftruncate(self._file, journal.length)
            self.journal = replace(journal, torn=False)

    def append(self, action: Action) -> None:
        """Write an action; when this returns, it is on the disk.

        Raises
        ------
        OSError
            Where it cannot be; the journal is then as it was before.
        """
        line = msgspec.json.encode(action) + b"\n"
        length = self.journal.length
        try:
            written = 0
            while written < len(line):  # a disk that is nearly full takes a part
                written += os.pwrite(self._file, line[written:], length + written)
            os.fsync(self._file)
        except OSError:
            os.ftruncate(self._file, length)
            raise
        actions = (*self.journal.actions, action)
        self.journal = replace(self.journal, actions=actions, length=length + len(line))

    def close(self) -> None:
        """Close the file."""
        os.close(self._file)


def _begun(path: Path, journal: Journal) -> Journal:
    """Write the first line; the file is there whole or not at all."""
    line = msgspec.json.encode(journal.header) + b"\n"
    fresh = path.with_name(f"{path.name}.new")
    fresh.write_bytes(line)
    replace_durably(fresh, path)
    return replace(journal, length=len(line))
