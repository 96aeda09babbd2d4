"""The annotations of a recording, kept beside it: what is acknowledged is on the disk."""

from __future__ import annotations

import secrets
import threading
import time
from dataclasses import replace
from typing import TYPE_CHECKING, Self

from groundtrace_codecs.annotations import Annotation, Sidecar, in_order, sidecar_path
from groundtrace_codecs.errors import CodecError

from ..errors import AnnotationError
from .checks import AUTHOR, checked, named
from .journal import Action, Change, JournalWriter, apply
from .lock import WriterLock
from .merging import Merge, incoming, merged
from .reading import journal_of, stored

if TYPE_CHECKING:
    from pathlib import Path
    from types import TracebackType
    from typing import Literal

    from groundtrace_codecs.annotations import RecordingKey
    from groundtrace_codecs.labels import Label

    from .checks import Extent
    from .reading import Stored


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

    def __init__(self, recording: Path, found: Stored, author: str, lock: WriterLock) -> None:
        self.path = sidecar_path(recording)
        self.author = author
        self.key: RecordingKey = found.key
        self.extent: Extent = found.extent
        self.remarks = found.kept.remarks
        self._items = {a.id: a for a in found.kept.annotations}
        self._begun = found.kept.journal
        self._journal_path = journal_of(self.path)
        self._writer: JournalWriter | None = None
        self._lock = lock
        self._one_at_a_time = threading.RLock()
        if self._begun.length and not found.kept.current:
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
            found = self._items.get(id_)
        if found is None:
            raise AnnotationError(
                f"{self.path.name}: expected an annotation {id_[:40]!r}, found none"
            )
        return found

    def add(self, label: Label) -> Annotation:
        """Keep a label; without an author it is this one's.

        Raises
        ------
        AnnotationError
            Where it is not as :func:`~groundtrace.annotate.checks.checked` expects, or cannot be
            kept.
        """
        kept = self._checked(label, self.author)
        with self._one_at_a_time:
            now = time.time_ns()
            added = Annotation(self._new_id(), kept, now, now)
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
            kept = self._checked(label, before.label.author)
            after = replace(before, label=kept, edited_ns=time.time_ns())
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
        kept = Sidecar(self.key, self.items, journal.header.id, len(journal.actions))
        try:
            write_sidecar(self.path, kept)
        except (OSError, CodecError) as error:
            raise AnnotationError(
                f"{self.path}: expected to be written, found: {error}; "
                f"the journal {self._journal_path.name} has all of it"
            ) from error


def _unwritable(beside: Path, error: OSError) -> AnnotationError:
    return AnnotationError(
        f"{beside.parent}: expected a folder to keep the annotations in, found: {error.strerror}"
    )
