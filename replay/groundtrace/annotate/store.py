"""The annotations of a recording, kept beside it: what is acknowledged is on the disk."""

from __future__ import annotations

import math
import os
import secrets
import threading
import time
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal, Self

import msgspec
from filelock import FileLock, Timeout

from groundtrace_codecs.annotations import (
    Annotation,
    RecordingKey,
    Sidecar,
    annotated,
    in_order,
    journal_of,
    read_sidecar,
    replace_durably,
    sidecar_path,
)
from groundtrace_codecs.errors import CodecError, not_written
from groundtrace_codecs.events import ANNOTATION_KINDS, SPAN_KINDS
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S

from ..errors import AnnotationError, RecordingError
from ..pipeline.results import RUN, file_sha256
from .agreement import Conflict, conflicts, from_json

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence
    from pathlib import Path
    from types import TracebackType

    from groundtrace_codecs.events import Label

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
        annotation = self.after or self.before
        return annotation.id if annotation is not None else ""

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
    complete = content[: content.rfind(b"\n") + 1]
    lines = complete.splitlines(keepends=True)
    header = _header(lines[0] if lines else b"", path.name)
    actions: list[Action] = []
    length = len(lines[0])
    for number, line in enumerate(lines[1:], 2):
        try:
            actions.append(msgspec.json.decode(line, type=Action))
        except (msgspec.DecodeError, UnicodeDecodeError) as error:
            if number == len(lines) and len(complete) == len(content):
                break
            where = f"{path.name}: line {number}"
            raise AnnotationError(f"{where}: expected an action, found: {error}") from error
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
        self._file = path.open("r+b", buffering=0)
        if journal.torn:
            self._file.truncate(journal.length)
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
            written = self._file.seek(length) - length
            while written < len(line):  # a disk that is nearly full takes a part
                written += self._file.write(line[written:]) or 0
            os.fsync(self._file.fileno())
        except OSError:
            self._file.truncate(length)
            raise
        actions = (*self.journal.actions, action)
        self.journal = replace(self.journal, actions=actions, length=length + len(line))

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def _begun(path: Path, journal: Journal) -> Journal:
    """Write the first line; the file is there whole or not at all."""
    line = msgspec.json.encode(journal.header) + b"\n"
    fresh = path.with_name(f"{path.name}.new")
    fresh.write_bytes(line)
    replace_durably(fresh, path)
    return replace(journal, length=len(line))


class WriterLock:
    """Holds a lock file until it is released or the process ends, however it ends.

    The system's own lock on the file decides, not that the file is there: that of a process that
    died is free.

    Parameters
    ----------
    path
        The lock file.

    Raises
    ------
    AnnotationError
        Where another holds it.
    OSError
        Where it cannot be made.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lock = FileLock(path, timeout=0)
        try:
            self._lock.acquire()
        except Timeout as error:
            holder = "?"
            with suppress(OSError):  # Windows lets nobody read what is locked
                holder = path.read_text("ascii", "replace").strip() or holder
            raise AnnotationError(
                f"{path.name}: expected nobody else annotating this recording, "
                f"found process {holder}"
            ) from error
        with suppress(OSError):
            path.write_text(f"{os.getpid()}\n", "ascii")

    def release(self) -> None:
        """Let others write."""
        with suppress(OSError):  # Windows removes nothing that is open
            self._path.unlink()
        self._lock.release()


@dataclass(frozen=True, slots=True)
class StoredState:
    """What lies beside a recording.

    Attributes
    ----------
    annotations
        By time.
    journal
        What was done so far; without a length where there is no journal yet.
    current
        Whether the sidecar holds all of it.
    remarks
        What was found amiss and left out, one line each.
    """

    annotations: tuple[Annotation, ...]
    journal: Journal
    current: bool
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Stored:
    """A recording and its annotations.

    Attributes
    ----------
    key
        The recording.
    extent
        Its first and last sample.
    content
        Its annotations, and how they are kept.
    """

    key: RecordingKey
    extent: Extent
    content: StoredState

    @property
    def labels(self) -> tuple[Label, ...]:
        """What the annotations say, by time."""
        return tuple(a.label for a in self.content.annotations)


def stored(recording: Path) -> Stored:
    """Return the annotations of a recording; nothing is written.

    Those beside it: the sidecar, and what its journal has more, as after a process was killed.
    Where neither is there, those inside the recording, as ``--commit`` leaves them.

    Parameters
    ----------
    recording
        The recording's file.

    Raises
    ------
    AnnotationError
        Where what lies beside belongs to another recording or cannot be read.
    RecordingError, CodecError
        Where the recording has no signals or cannot be read.
    """
    key, extent, inside = _described(recording)
    if annotated(recording):
        return Stored(key, extent, kept_in(sidecar_path(recording), key))
    return Stored(key, extent, StoredState(inside, _new_journal(key, inside), current=False))


def _described(recording: Path) -> tuple[RecordingKey, Extent, tuple[Annotation, ...]]:
    with Recording.open(recording) as opened:
        if not opened.streams or RUN in opened.metadata:
            actual = "a result" if RUN in opened.metadata else "none"
            raise RecordingError(f"{opened.name}: expected signals to annotate, found {actual}")
        names = frozenset(c.name for stream in opened.streams for c in stream.channels)
        extent = Extent(opened.start_ns, opened.end_ns, names)
        inside = opened.annotations
    key = RecordingKey(recording.name, file_sha256(recording), extent.start_ns)
    return key, extent, inside


def _new_journal(key: RecordingKey, base: tuple[Annotation, ...]) -> Journal:
    header = Header(FORMAT, VERSION, secrets.token_hex(8), key, base)
    return Journal(header, (), 0, torn=False)


def kept_in(path: Path, key: RecordingKey) -> StoredState:
    """Return what a sidecar and its journal hold together.

    The sidecar is read first: whoever writes meanwhile journals first, so the journal has no less.

    Parameters
    ----------
    path
        The sidecar; it or its journal is there.
    key
        The recording they must belong to.

    Raises
    ------
    AnnotationError
        Where one of them belongs to another recording, or they do not belong together.
    CodecError
        Where the sidecar cannot be read and there is no journal.
    """
    sidecar = _sidecar_of(path, key)
    journal = _journal_of(path, key)
    remarks: list[str] = []
    if isinstance(sidecar, CodecError):
        if journal is None:
            raise sidecar
        remarks.append(f"{sidecar}; its journal has all of it")
        sidecar = None
    if journal is None and sidecar is not None:
        begun = _new_journal(key, sidecar.annotations)
        return StoredState(sidecar.annotations, begun, current=False)
    if journal is None:
        raise AnnotationError(f"{path}: expected annotations, found no such file")
    _check_pair(sidecar, journal, path)
    if journal.torn:
        name = journal_of(path).name
        remarks.append(f"{name}: the last line is torn and left out: it was never acknowledged")
    current = sidecar is not None and sidecar.actions == len(journal.actions)
    annotations = in_order(journal.items().values())
    return StoredState(annotations, journal, current=current, remarks=tuple(remarks))


def _sidecar_of(path: Path, key: RecordingKey) -> Sidecar | CodecError | None:
    """Return the sidecar, or why it cannot be read: its journal may do without it."""
    if not path.is_file():
        return None
    try:
        sidecar = read_sidecar(path)
    except CodecError as error:
        return error
    check_key(sidecar.key, key, path.name)
    return sidecar


def _journal_of(sidecar: Path, key: RecordingKey) -> Journal | None:
    path = journal_of(sidecar)
    if not path.is_file():
        return None
    journal = read_journal(path)
    check_key(journal.header.recording, key, path.name)
    return journal


def _check_pair(sidecar: Sidecar | None, journal: Journal, path: Path) -> None:
    """Refuse a sidecar and a journal of which neither holds all of the other."""
    if sidecar is None:
        return
    where = journal_of(path).name
    if journal.header.id != sidecar.journal:
        raise AnnotationError(
            f"{where}: expected the journal of {path.name}, found that of another; move one of "
            "the two away, and take it in with --merge"
        )
    if sidecar.actions > len(journal.actions):
        raise AnnotationError(
            f"{where}: expected the {sidecar.actions} actions of {path.name}, "
            f"found {len(journal.actions)}; move it away to go on with the sidecar"
        )


def check_key(actual: RecordingKey, expected: RecordingKey, name: str) -> None:
    """Refuse annotations of another recording.

    Raises
    ------
    AnnotationError
        Where the hashes differ; names ``name``.
    """
    if actual.sha256 != expected.sha256:
        raise AnnotationError(
            f"{name}: recording: expected {expected.name[:80]} (sha256 {expected.sha256[:12]}), "
            f"found annotations of {actual.name[:80]} (sha256 {actual.sha256[:12]})"
        )


#: Who annotates where nobody says so; the name of the system's user is nobody's business.
AUTHOR = "annotator"
#: Times may be rounded this far beyond the recording, as printed ones are [ns]. Chosen by
#: judgement: times are printed with milliseconds.
_ROUNDING_NS = 1_000_000
#: Longest name and note of a mark [characters]. Chosen by judgement: a line and some pages, so that
#: a file of others cannot fill memory.
_LONGEST_NAME, _LONGEST_NOTE = 100, 10_000
#: The first number that int64 does not hold. Source: definition.
_INT64_LIMIT = 1 << 63


@dataclass(frozen=True, slots=True)
class Extent:
    """What there is of a recording to be annotated.

    Attributes
    ----------
    start_ns, end_ns
        First and last sample [ns].
    channels
        Names of all channels.
    """

    start_ns: int
    end_ns: int
    channels: frozenset[str]

    def seconds(self, time_ns: int) -> float:
        """Return a time as seconds since the first sample."""
        return (time_ns - self.start_ns) / NS_PER_S


def named(author: str, where: str = "author") -> str:
    """Return the name of an annotator.

    Raises
    ------
    AnnotationError
        Where it is empty, long, or more than a line.
    """
    if not author.strip():
        raise AnnotationError(f"{where}: expected a name, found nothing")
    return _text(author.strip(), where, _LONGEST_NAME, one_line=True)


def checked(label: Label, extent: Extent, where: str = "annotation") -> Label:
    """Return a label that may be kept as an annotation.

    Raises
    ------
    AnnotationError
        Where the kind is not one of those a person may mark, a time lies outside the recording, or
        a kind lacks what it needs; names ``where`` and the field.
    """
    if label.kind not in ANNOTATION_KINDS:
        kinds = ", ".join(sorted(ANNOTATION_KINDS))
        raise AnnotationError(f"{where}: kind: expected one of {kinds}, found {label.kind[:40]!r}")
    _check_times(label, extent, where)
    if label.channel not in extent.channels and (label.channel or label.kind == "pick"):
        names = ", ".join(sorted(extent.channels))
        actual = repr(label.channel[:40]) if label.channel else "none"
        raise AnnotationError(f"{where}: channel: expected one of {names}, found {actual}")
    for name in ("x_m", "y_m", "value"):
        number = getattr(label, name)
        if number is not None and not math.isfinite(number):
            raise AnnotationError(f"{where}: {name}: expected a finite number, found {number}")
    for name in ("channel", "label", "target"):
        _text(getattr(label, name), f"{where}: {name}", _LONGEST_NAME, one_line=True)
    _text(label.note, f"{where}: note", _LONGEST_NOTE)
    return replace(label, author=named(label.author, f"{where}: author"))


def checked_annotation(annotation: Annotation, extent: Extent, where: str) -> Annotation:
    """Return an annotation made elsewhere that may be kept here.

    Raises
    ------
    AnnotationError
        As :func:`checked`, or where its id or wall clock cannot be kept.
    """
    at = f"{where}: {annotation.id[:40]!r}"
    if not annotation.id:
        raise AnnotationError(f"{where}: id: expected one, found nothing")
    _text(annotation.id, f"{at}: id", _LONGEST_NAME, one_line=True)
    for name in ("created_ns", "edited_ns"):
        if not 0 <= getattr(annotation, name) < _INT64_LIMIT:
            actual = getattr(annotation, name)
            raise AnnotationError(f"{at}: {name}: expected an int64 from 0 on, found {actual}")
    return replace(annotation, label=checked(annotation.label, extent, at))


def _check_times(label: Label, extent: Extent, where: str) -> None:
    times = [("time", label.time_ns)]
    if label.end_ns is not None:
        times.append(("end", label.end_ns))
    for name, time_ns in times:
        early = time_ns < extent.start_ns - _ROUNDING_NS
        if early or time_ns < 0 or time_ns > extent.end_ns + _ROUNDING_NS:
            last = extent.seconds(extent.end_ns)
            raise AnnotationError(
                f"{where}: {name}: expected 0 to {last:.3f} s, as long as the recording is, "
                f"found {extent.seconds(time_ns):.3f} s"
            )
    if label.kind in SPAN_KINDS:
        if label.end_ns is None or label.end_ns <= label.time_ns:
            actual = "none" if label.end_ns is None else "one before it"
            raise AnnotationError(
                f"{where}: end: expected one after the start, as {label.kind} is a span, "
                f"found {actual}"
            )
    elif label.end_ns is not None:
        raise AnnotationError(
            f"{where}: end: expected none, as {label.kind} is a moment, found one"
        )


def _text(text: str, where: str, longest: int, *, one_line: bool = False) -> str:
    if len(text) > longest:
        raise AnnotationError(f"{where}: expected at most {longest} characters, found {len(text)}")
    if one_line and not text.isprintable():
        raise AnnotationError(f"{where}: expected printable text in one line, found {text!r}")
    try:
        text.encode()
    except UnicodeEncodeError as error:
        raise AnnotationError(f"{where}: expected Unicode text, found {error.reason}") from error
    return text


class Annotations:
    """The annotations of one recording, open to be changed; a context manager.

    Made by :meth:`open`. Every action is appended to ``REC.annotations.journal`` and on the disk
    before its method returns; the sidecar ``REC.annotations.mcap`` is then written anew, and is at
    any moment whole. Methods may be called from several threads.

    Attributes
    ----------
    path
        The sidecar.
    author
        Who annotates.
    key
        The recording: file name, SHA-256, first sample.
    extent
        Its first and last sample.
    remarks
        What was found amiss when opening, one line each.
    """

    def __init__(self, recording: Path, state: Stored, author: str, lock: WriterLock) -> None:
        self.path = sidecar_path(recording)
        self.author = author
        self.key: RecordingKey = state.key
        self.extent: Extent = state.extent
        self.remarks = state.content.remarks
        self._items = {a.id: a for a in state.content.annotations}
        self._begun = state.content.journal
        self._journal_path = journal_of(self.path)
        self._writer: JournalWriter | None = None
        self._lock = lock
        self._one_at_a_time = threading.RLock()
        if self._begun.length and not state.content.current:
            self._write_sidecar()

    @classmethod
    def open(cls, recording: Path, author: str = AUTHOR) -> Self:
        """Open the annotations of a recording; without any, an empty set.

        Parameters
        ----------
        recording
            The recording's file, with signals.
        author
            Name of whoever annotates, as it will be kept.

        Raises
        ------
        AnnotationError
            Where somebody else has them open, they belong to another recording, or nothing can be
            written beside the recording.
        RecordingError, CodecError
            Where the recording has no signals or cannot be read.
        """
        name = named(author)
        if not recording.is_file():
            raise AnnotationError(f"{recording}: expected a recording, found no such file")
        try:
            lock = WriterLock(recording.with_name(f"{recording.stem}.annotations.lock"))
        except OSError as error:
            raise _unwritable(recording, error) from error
        try:
            return cls(recording, stored(recording), name, lock)
        except BaseException:
            lock.release()
            raise

    def close(self) -> None:
        """Let others annotate."""
        with self._one_at_a_time:
            if self._writer is not None:
                self._writer.close()
                self._writer = None
            self._lock.release()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    @property
    def items(self) -> tuple[Annotation, ...]:
        """The annotations, by time."""
        with self._one_at_a_time:
            return in_order(self._items.values())

    def of(self, id_: str) -> Annotation:
        """Return the annotation with an id.

        Raises
        ------
        AnnotationError
            Where there is none.
        """
        with self._one_at_a_time:
            annotation = self._items.get(id_)
        if annotation is None:
            raise AnnotationError(
                f"{self.path.name}: expected an annotation {id_[:40]!r}, found none"
            )
        return annotation

    def add(self, label: Label) -> Annotation:
        """Keep a label; without an author it is this one's.

        Raises
        ------
        AnnotationError
            Where it is not as :func:`checked` expects, or cannot be
            kept.
        """
        checked_label = self._checked(label, self.author)
        with self._one_at_a_time:
            now = time.time_ns()
            added = Annotation(self._new_id(), checked_label, now, now)
            self._do("add", (Change(None, added),))
        return added

    def edit(self, id_: str, label: Label) -> Annotation:
        """Say something else; without an author it stays that of who said it first.

        Raises
        ------
        AnnotationError
            As :meth:`add`, or where there is no such annotation.
        """
        with self._one_at_a_time:
            before = self.of(id_)
            checked_label = self._checked(label, before.label.author)
            after = replace(before, label=checked_label, edited_ns=time.time_ns())
            self._do("edit", (Change(before, after),))
        return after

    def delete(self, id_: str) -> Annotation:
        """Take an annotation away, and return it.

        Raises
        ------
        AnnotationError
            Where there is no such annotation.
        """
        with self._one_at_a_time:
            gone = self.of(id_)
            self._do("delete", (Change(gone, None),))
        return gone

    def undo(self) -> str | None:
        """Take this author's last action back, then the one before, and so on.

        Returns
        -------
        str or None
            What was taken back; None where there is nothing left.

        Raises
        ------
        AnnotationError
            Where somebody has changed the annotation since.
        """
        with self._one_at_a_time:
            journal = self._writer.journal if self._writer is not None else self._begun
            number = journal.last_of(self.author)
            if number is None:
                return None
            action = journal.actions[number - 1]
            changes = tuple(change.reversed for change in reversed(action.changes))
            for change in changes:
                if self._items.get(change.id) != change.before:
                    raise AnnotationError(
                        f"undo: expected {change.id} as {self.author} left it, found it changed "
                        "since"
                    )
            self._do("undo", changes, undoes=number)
            what = ", ".join(change.id for change in action.changes[:3])
            return f"{action.action} {what}" + (" ..." if len(changes) > 3 else "")

    def merge(self, path: Path) -> Merge:
        """Take in annotations of the same recording: a sidecar, or JSON as the page gives it.

        Raises
        ------
        AnnotationError
            Where the file is neither, or of another recording.
        """
        others = incoming(path, self.key, self.extent)
        with self._one_at_a_time:
            result = merged(self._items, self._ids(), others)
            if result.added:
                self._do("merge", result.changes)
        return result

    def _checked(self, label: Label, author: str) -> Label:
        by = label.author or author
        return checked(replace(label, author=by), self.extent, f"{self.key.name}: annotation")

    def _ids(self) -> set[str]:
        return (self._writer.journal if self._writer is not None else self._begun).ids()

    def _new_id(self) -> str:
        used = self._ids()
        while (fresh := secrets.token_hex(4)) in used:
            pass
        return fresh

    def _do(
        self,
        what: Literal["add", "edit", "delete", "merge", "undo"],
        changes: tuple[Change, ...],
        undoes: int | None = None,
    ) -> None:
        """Journal an action, then write the sidecar."""
        action = Action(what, self.author, time.time_ns(), changes, undoes)
        try:
            if self._writer is None:
                self._writer = JournalWriter(self._journal_path, self._begun)
            self._writer.append(action)
        except OSError as error:
            raise _unwritable(self.path, error) from error
        apply(changes, self._items)
        self._write_sidecar()

    def _write_sidecar(self) -> None:
        from groundtrace_codecs.writer import write_sidecar

        journal = self._writer.journal if self._writer is not None else self._begun
        sidecar = Sidecar(self.key, self.items, journal.header.id, len(journal.actions))
        there = f"; the journal {self._journal_path.name} has all of it"
        try:
            write_sidecar(self.path, sidecar)
        except CodecError as error:
            raise AnnotationError(f"{error}{there}") from error
        except OSError as error:
            text = f"{self.path}: {not_written(error.strerror)}{there}"
            raise AnnotationError(text) from error


def _unwritable(beside: Path, error: OSError) -> AnnotationError:
    return AnnotationError(
        f"{beside.parent}: expected a folder to keep the annotations in, found: {error.strerror}"
    )


_MCAP_MAGIC = b"\x89MCAP"


@dataclass(frozen=True, slots=True)
class Merge:
    """What came of taking in annotations.

    Attributes
    ----------
    added
        What is new here.
    same
        How many were here already.
    conflicts
        Where what came contradicts what is here; in doubt nothing here was changed.
    """

    added: tuple[Annotation, ...]
    same: int
    conflicts: tuple[Conflict, ...]

    @property
    def changes(self) -> tuple[Change, ...]:
        """What is to be done."""
        return tuple(Change(None, a) for a in self.added)


def incoming(path: Path, key: RecordingKey, extent: Extent) -> tuple[Annotation, ...]:
    """Read annotations of a recording out of a sidecar or a JSON file, told by its bytes.

    Raises
    ------
    AnnotationError
        Where the file is neither, or its annotations are of another recording or not as they must
        be.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise AnnotationError(f"{path}: expected annotations, found: {error.strerror}") from error
    if content.startswith(_MCAP_MAGIC):
        try:
            sidecar = read_sidecar(path)
        except CodecError as error:
            raise AnnotationError(str(error)) from error
        file_key, annotations = sidecar.key, sidecar.annotations
    else:
        file_key, annotations = from_json(content, key.start_ns, path.name)
    check_key(file_key, key, path.name)
    return tuple(checked_annotation(a, extent, path.name) for a in annotations)


def merged(
    items: Mapping[str, Annotation], past_ids: Collection[str], others: Sequence[Annotation]
) -> Merge:
    """Compare annotations that came with those that are here.

    Parameters
    ----------
    items
        What is here, by id.
    past_ids
        Every id that was ever here.
    others
        What came.

    Returns
    -------
    Merge
        What is new is to be added. Of an annotation that was changed or deleted here, or has come
        in two forms, what is here stays and a conflict says so.
    """
    added: dict[str, Annotation] = {}
    labels = {a.label for a in items.values()}
    clashes: list[Conflict] = []
    same = 0
    for other in others:
        here = items.get(other.id) or added.get(other.id)
        if here is None and other.id in past_ids:
            clashes.append(Conflict("deleted here", (other,)))
        elif here is not None and here.label != other.label:
            clashes.append(Conflict("edited", (here, other)))
        elif here is not None or other.label in labels:
            same += 1
        else:
            added[other.id] = other
            labels.add(other.label)
    everything = [*items.values(), *added.values()]
    clashes += [c for c in conflicts(everything) if any(a.id in added for a in c.annotations)]
    return Merge(tuple(added.values()), same, tuple(clashes))
