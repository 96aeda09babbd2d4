"""The annotations of a recording as they are: out of the sidecar and what its journal has more."""

from __future__ import annotations

import secrets
from dataclasses import dataclass
from typing import TYPE_CHECKING

from groundtrace_codecs.annotations import RecordingKey, in_order, read_sidecar, sidecar_path
from groundtrace_codecs.errors import CodecError
from groundtrace_codecs.recording import Recording

from ..errors import AnnotationError, RecordingError
from ..results import RUN, file_sha256
from .checks import Extent
from .journal import FORMAT, VERSION, Header, Journal, read_journal

if TYPE_CHECKING:
    from pathlib import Path

    from groundtrace_codecs.annotations import Annotation, Sidecar
    from groundtrace_codecs.labels import Label


@dataclass(frozen=True, slots=True)
class Kept:
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
    kept
        Its annotations, and how they are kept.
    """

    key: RecordingKey
    extent: Extent
    kept: Kept

    @property
    def labels(self) -> tuple[Label, ...]:
        """What the annotations say, by time."""
        return tuple(a.label for a in self.kept.annotations)


def journal_of(sidecar: Path) -> Path:
    """Return where the journal of a sidecar is."""
    return sidecar.with_suffix(".journal")


def annotated(recording: Path) -> bool:
    """Whether anything lies beside a recording that holds annotations of it."""
    sidecar = sidecar_path(recording)
    return sidecar.is_file() or journal_of(sidecar).is_file()


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
    return Stored(key, extent, Kept(inside, _new_journal(key, inside), current=False))


def _described(recording: Path) -> tuple[RecordingKey, Extent, tuple[Annotation, ...]]:
    with Recording.open(recording) as opened:
        if not opened.streams or RUN in opened.metadata:
            found = "a result" if RUN in opened.metadata else "none"
            raise RecordingError(f"{opened.name}: expected signals to annotate, found {found}")
        names = frozenset(c.name for stream in opened.streams for c in stream.channels)
        extent = Extent(opened.start_ns, opened.end_ns, names)
        inside = opened.annotations
    key = RecordingKey(recording.name, file_sha256(recording), extent.start_ns)
    return key, extent, inside


def _new_journal(key: RecordingKey, base: tuple[Annotation, ...]) -> Journal:
    header = Header(FORMAT, VERSION, secrets.token_hex(8), key, base)
    return Journal(header, (), 0, torn=False)


def kept_in(path: Path, key: RecordingKey) -> Kept:
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
        return Kept(sidecar.annotations, begun, current=False)
    if journal is None:
        raise AnnotationError(f"{path}: expected annotations, found no such file")
    _check_pair(sidecar, journal, path)
    if journal.torn:
        name = journal_of(path).name
        remarks.append(f"{name}: the last line is torn and left out: it was never acknowledged")
    current = sidecar is not None and sidecar.actions == len(journal.actions)
    annotations = in_order(journal.items().values())
    return Kept(annotations, journal, current=current, remarks=tuple(remarks))


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
    place = journal_of(path).name
    if journal.header.id != sidecar.journal:
        raise AnnotationError(
            f"{place}: expected the journal of {path.name}, found that of another; move one of "
            "the two away, and take it in with --merge"
        )
    if sidecar.actions > len(journal.actions):
        raise AnnotationError(
            f"{place}: expected the {sidecar.actions} actions of {path.name}, "
            f"found {len(journal.actions)}; move it away to go on with the sidecar"
        )


def check_key(found: RecordingKey, expected: RecordingKey, name: str) -> None:
    """Refuse annotations of another recording.

    Raises
    ------
    AnnotationError
        Where the hashes differ; names ``name``.
    """
    if found.sha256 != expected.sha256:
        raise AnnotationError(
            f"{name}: recording: expected {expected.name[:80]} (sha256 {expected.sha256[:12]}), "
            f"found annotations of {found.name[:80]} (sha256 {found.sha256[:12]})"
        )
