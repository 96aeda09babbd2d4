"""``groundtrace annotate``."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from decimal import Decimal, InvalidOperation
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import msgspec
from cyclopts import Parameter, validators

from groundtrace_codecs.annotations import sidecar_path
from groundtrace_codecs.events import Label
from groundtrace_codecs.signals import NS_PER_S

from ..annotate.agreement import conflicts as conflicts_of
from ..annotate.agreement import document_of
from ..annotate.store import AUTHOR, Annotations, named, stored
from ..api.files import existing, writable
from ..errors import AnnotationError
from ..pipeline.config import checked_pipeline
from .console import print_json, print_stderr, print_table, progress
from .options import FLAG, OUT, Texts

if TYPE_CHECKING:
    from collections.abc import Iterator

    from groundtrace_codecs.annotations import Annotation, RecordingKey

    from ..annotate.agreement import Conflict
    from ..annotate.store import Extent, Merge

_MARK = re.compile(r"(?P<kind>[a-z]+)@(?P<from>[0-9.]+)(?:-(?P<to>[0-9.]+))?")


@dataclass(frozen=True, slots=True)
class _Words:
    """What is said beside kind and times; None where nothing is said about it."""

    label: str | None
    channel: str | None
    note: str | None

    def put(self, label: Label) -> Label:
        """Return a label with these words."""
        given = {
            name: value for name in self.__slots__ if (value := getattr(self, name)) is not None
        }
        return replace(label, **given)


@dataclass(frozen=True, slots=True)
class _Asked:
    """What is to be changed, in this order."""

    merge: list[Path]
    add: list[str]
    edit: tuple[str, str] | None
    delete: list[str]
    undo: bool
    words: _Words

    @property
    def anything(self) -> bool:
        """Whether anything is."""
        return bool(self.merge or self.add or self.edit or self.delete or self.undo)


def annotate(
    recording: Path,
    *,
    add: Texts = None,
    label: str | None = None,
    channel: str | None = None,
    note: str | None = None,
    author: str = AUTHOR,
    edit: Annotated[tuple[str, str] | None, Parameter(negative="")] = None,
    delete: Texts = None,
    undo: Annotated[bool, FLAG] = False,
    merge: Annotated[list[Path] | None, Parameter(negative="", consume_multiple=True)] = None,
    list_: Annotated[bool, Parameter(name="--list", negative="")] = False,
    conflicts: Annotated[bool, FLAG] = False,
    commit: Annotated[bool, FLAG] = False,
    out: Annotated[Path | None, OUT] = None,
    force: Annotated[bool, FLAG] = False,
    serve: Annotated[bool, FLAG] = False,
    results: Path | None = None,
    pipeline: str = "",
    port: Annotated[int, Parameter(validator=validators.Number(gte=0, lt=65536))] = 0,
    no_browser: Annotated[bool, FLAG] = False,
    json: Annotated[bool, FLAG] = False,
) -> None:
    """Mark what happened in a recording: missed and false steps, steps, picks, notes, spans.

    Everything is kept in REC.annotations.mcap beside the recording, at once, with the journal
    REC.annotations.journal of every action.

    Parameters
    ----------
    recording
        MCAP file with signals.
    add
        KIND@SECONDS, or for spans KIND@FROM-TO, in seconds after the first sample; may be given
        several times. Moments: missed (a step that was not detected), false (a detection where no
        step is), step, pick, note. Spans: walking, ignore, disturbed, pass, span.
    label
        Of steps left, right, forward, backward, ...; of a span its word.
    channel
        Channel concerned; a pick needs one.
    note
        Free text.
    author
        Who annotates. Not the name of the system's user, which is not kept.
    edit
        ID KIND@SECONDS: say this instead; --label, --channel and --note replace what was said,
        without them it stays.
    delete
        ID to take away; may be given several times.
    undo
        Take the last action of --author back; again, the one before.
    merge
        Take in what others annotated: their REC.annotations.mcap, or JSON of this command or of
        the page. Conflicts are listed.
    list_
        List all; so does giving nothing else to do.
    conflicts
        List where authors contradict each other.
    commit
        Write a copy of the recording with the annotations inside, to --out.
    out
        The copy.
    force
        Overwrite an existing copy.
    serve
        Annotate on a page in the browser, with the replay.
    results
        What is shown on the page, as groundtrace replay wrote it.
    pipeline
        What is shown without --results: a pipeline's name or TOML file. Without either, the one
        that fits the recording, or the signals alone.
    port
        Of the page; 0 chooses a free one.
    no_browser
        Print the page's address, and open no browser.
    json
        Print one JSON document; --merge takes it.
    """
    path = existing(recording)
    if commit != (out is not None):
        found = "--commit alone" if commit else "--out alone"
        raise AnnotationError(f"--commit: expected it together with --out FILE, found {found}")
    if pipeline and results is not None:
        raise AnnotationError("--pipeline: expected it or --results, found both")
    if pipeline:
        checked_pipeline(pipeline)
    if out is not None:
        writable(out, force=force, sources=[path])
    words = _Words(label, channel, note)
    asked = _Asked(merge or [], add or [], edit, delete or [], undo, words)
    _check_words(asked)
    serving = _server() if serve else None
    done = _changed(path, author, asked) if asked.anything else _as_it_is(path)
    if out is not None:
        done = _committed(path, done, out)
    if json:
        print_document(done, conflicts=conflicts)
    else:
        _report(done, asked, listed=list_, conflicts=conflicts, other=serve or commit)
    if serving is not None:
        shown = None if pipeline else _results(path, results)
        serving(path, shown, pipeline, named(author), port, not no_browser)


def _check_words(asked: _Asked) -> None:
    """Refuse words without anything that they are said of."""
    given = [f"--{n}" for n in asked.words.__slots__ if getattr(asked.words, n) is not None]
    if given and not asked.add and asked.edit is None:
        raise AnnotationError(f"{given[0]}: expected --add or --edit with it, found neither")


def _server() -> Any:
    from ..pipeline.plugins import load, plugins

    if "annotate" not in {plugin.name for plugin in plugins("views")}:
        raise AnnotationError("--serve: expected an installed page (groundtrace.views), found none")
    return partial(load("views", "annotate"), report=print_stderr, progress=progress)


def _results(path: Path, given: Path | None) -> Path | None:
    """Return the results to show: those given, or those that replay leaves."""
    if given is not None:
        return existing(given, "results")
    name = f"{path.stem}.results.mcap"
    return next((p for p in (path.with_name(name), Path(name)) if p.is_file()), None)


def _as_it_is(path: Path) -> Done:
    found = stored(path)
    return Done(path, found.key, found.extent, found.kept.annotations, found.kept.remarks)


def _changed(path: Path, author: str, asked: _Asked) -> Done:
    """Do what is asked, each action safe before the next."""
    with Annotations.open(path, author) as store:
        merges = tuple((file, store.merge(file)) for file in asked.merge)
        actions: list[tuple[str, Annotation]] = []
        for text in asked.add:
            label = asked.words.put(parse_mark(text, store.extent, "--add"))
            actions.append(("added", store.add(label)))
        if asked.edit is not None:
            actions.append(("edited", _edited(store, *asked.edit, asked.words)))
        actions.extend(("deleted", store.delete(id_)) for id_ in asked.delete)
        undone = store.undo() if asked.undo else None
        return Done(
            path,
            store.key,
            store.extent,
            store.items,
            store.remarks,
            tuple(actions),
            undone,
            merges,
        )


def _edited(store: Annotations, id_: str, text: str, words: _Words) -> Annotation:
    before = store.of(id_).label
    mark = parse_mark(text, store.extent, "--edit")
    label = replace(before, kind=mark.kind, time_ns=mark.time_ns, end_ns=mark.end_ns)
    return store.edit(id_, words.put(label))


def parse_mark(text: str, extent: Extent, option: str) -> Label:
    """Return the label that KIND@SECONDS or KIND@FROM-TO says.

    Raises
    ------
    AnnotationError
        Where the text is neither; names ``option``.
    """
    found = _MARK.fullmatch(text)
    try:
        if found is None:
            raise InvalidOperation
        times = [Decimal(t) for t in found.group("from", "to") if t is not None]
    except InvalidOperation as error:
        raise AnnotationError(
            f"{option}: expected KIND@SECONDS or KIND@FROM-TO, found {text[:40]!r}"
        ) from error
    # beyond any recording; the check of times then says so
    since_ns = [round(min(t, Decimal(10**9)) * NS_PER_S) for t in times]
    start_ns, end_ns = (extent.start_ns + ns for ns in (since_ns[0], since_ns[-1]))
    return Label(start_ns, found.group("kind"), end_ns if len(times) > 1 else None)


def _committed(path: Path, done: Done, out: Path) -> Done:
    from groundtrace_codecs.copies import copy_with_annotations

    damage = copy_with_annotations(path, out, done.annotations)
    if damage:
        print_stderr(f"{path.name}: {damage} damaged places are not in the copy")
    return replace(done, committed=out)


def _report(done: Done, asked: _Asked, *, listed: bool, conflicts: bool, other: bool) -> None:
    """Print what was done, and what is asked to be listed."""
    for remark in done.remarks:
        print_stderr(remark)
    for line in done.lines(undo=asked.undo):
        print(line)
    if listed or not (asked.anything or conflicts or other):
        print_annotations(done)
    if conflicts:
        print_conflicts(done)
    if done.committed is not None:
        count = len(done.annotations)
        print(f"wrote {done.committed}: {done.path.name} and, inside, its {count} annotations")


@dataclass(frozen=True, slots=True)
class Done:
    """What a call of the command did, and what there is now.

    Attributes
    ----------
    path, key, extent
        The recording.
    annotations
        All there are now, by time.
    remarks
        What was found amiss.
    actions
        What was done to which annotation: ``added``, ``edited``, ``deleted``.
    undone
        What was taken back, if anything.
    merges
        Files that were taken in, and what came of it.
    committed
        The copy with the annotations inside, if any.
    """

    path: Path
    key: RecordingKey
    extent: Extent
    annotations: tuple[Annotation, ...]
    remarks: tuple[str, ...] = ()
    actions: tuple[tuple[str, Annotation], ...] = ()
    undone: str | None = None
    merges: tuple[tuple[Path, Merge], ...] = ()
    committed: Path | None = None

    def lines(self, *, undo: bool) -> Iterator[str]:
        """Yield what was done as lines; ``undo`` says whether anything was to be taken back."""
        for file, merge in self.merges:
            added, clashes = len(merge.added), len(merge.conflicts)
            yield f"merged {file.name}: {added} added, {merge.same} known, {clashes} conflicts"
            for conflict in merge.conflicts:
                yield f"  {self.conflict(conflict)}"
        for what, annotation in self.actions:
            yield f"{what} {annotation.id}: {self.annotation(annotation)}"
        if undo:
            yield "undone: " + (self.undone or "nothing, there is no action left")

    def annotation(self, annotation: Annotation) -> str:
        """Return an annotation as text."""
        label = annotation.label
        until = "" if label.end_ns is None else f" to {self.extent.seconds(label.end_ns):.3f}"
        words = " ".join(filter(None, (label.kind, label.label, label.channel)))
        return f"{words} at {self.extent.seconds(label.time_ns):.3f}{until} s by {label.author}"

    def conflict(self, conflict: Conflict) -> str:
        """Return a conflict as text."""
        told = " / ".join(f"{self.annotation(a)} ({a.id})" for a in conflict.annotations)
        return f"{conflict.reason}: {told}"


def print_annotations(done: Done) -> None:
    """Print a table of all annotations."""
    if not done.annotations:
        print(f"{done.path.name}: no annotations")
        return
    header = ("id", "time [s]", "end [s]", "kind", "label", "channel", "author", "note")
    print_table(header, [_row(done, a) for a in done.annotations])


def _row(done: Done, annotation: Annotation) -> tuple[str, ...]:
    label = annotation.label
    end = "" if label.end_ns is None else f"{done.extent.seconds(label.end_ns):.3f}"
    note = " ".join(label.note.split())
    words = (label.kind, label.label, label.channel, label.author, note)
    return (annotation.id, f"{done.extent.seconds(label.time_ns):.3f}", end, *words)


def print_conflicts(done: Done) -> None:
    """Print where authors contradict each other."""
    found = conflicts_of(done.annotations)
    print(f"{len(found)} conflicts" if found else "no conflicts")
    for conflict in found:
        print(f"  {done.conflict(conflict)}")


def print_document(done: Done, *, conflicts: bool) -> None:
    """Print all of it as one JSON document, which ``--merge`` takes."""
    document = msgspec.to_builtins(document_of(done.key, done.annotations))
    document |= {
        "sidecar": str(sidecar_path(done.path)),
        "actions": [{"action": what, "id": a.id} for what, a in done.actions],
        "undone": done.undone,
        "merged": [_merge(file, merge) for file, merge in done.merges],
        "committed": None if done.committed is None else str(done.committed),
        "remarks": list(done.remarks),
    }
    if conflicts:
        document["conflicts"] = _conflicts(done)
    print_json(document)


def _merge(file: Path, merge: Merge) -> dict[str, object]:
    return {
        "file": file.name,
        "added": len(merge.added),
        "same": merge.same,
        "conflicts": [_conflict(c) for c in merge.conflicts],
    }


def _conflicts(done: Done) -> list[dict[str, object]]:
    return [_conflict(c) for c in conflicts_of(done.annotations)]


def _conflict(conflict: Conflict) -> dict[str, object]:
    return {"reason": conflict.reason, "ids": [a.id for a in conflict.annotations]}
