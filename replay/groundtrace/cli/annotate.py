"""``groundtrace annotate``."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter, validators

from ..annotate.agreement import conflicts as conflicts_of
from ..annotate.changes import Changes, Done, Words, changed, document, unchanged
from ..annotate.store import AUTHOR, named
from ..api.files import existing_file, existing_recording, writable
from ..errors import AnnotationError
from ..pipeline.config import checked_pipeline
from .console import print_json, print_line, print_stderr, print_table
from .options import FLAG, OUT, PIPELINE, RECORDING, Texts

if TYPE_CHECKING:
    from collections.abc import Iterator

    from groundtrace_codecs.annotations import Annotation

    from ..annotate.agreement import Conflict


def annotate(
    recording: Annotated[Path, RECORDING],
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
    pipeline: Annotated[str, PIPELINE] = "",
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
        Annotator name; the system user name is never stored.
    edit
        ID KIND@SECONDS: change an annotation; --label, --channel and --note replace earlier values,
        without them it stays.
    delete
        ID to take away; may be given several times.
    undo
        Undo the author's last action; again, the one before.
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
    path = existing_recording(recording)
    if commit != (out is not None):
        given = "--commit alone" if commit else "--out alone"
        raise AnnotationError(f"--commit: expected it together with --out FILE, found {given}")
    if pipeline and results is not None:
        raise AnnotationError("--pipeline: expected it or --results, found both")
    if pipeline:
        checked_pipeline(pipeline)
    if out is not None:
        writable(out, force=force, sources=[path])
    words = Words(label, channel, note)
    asked = Changes(merge or [], add or [], edit, delete or [], undo, words)
    serving = _server() if serve else None
    done = changed(path, author, asked) if asked.anything else unchanged(path)
    if out is not None:
        done = _committed(path, done, out)
    if json:
        print_json(document(done, with_conflicts=conflicts))
    else:
        _report(done, asked, listed=list_, conflicts=conflicts, other=serve or commit)
    if serving is not None:
        shown = None if pipeline else _results(path, results)
        serving(path, shown, pipeline, named(author), port, not no_browser)


def _server() -> Any:
    from ..pipeline.plugins import load, plugins

    if "annotate" not in {plugin.name for plugin in plugins("views")}:
        raise AnnotationError("--serve: expected an installed page (groundtrace.views), found none")
    return partial(load("views", "annotate"), report=print_stderr)


def _results(path: Path, given: Path | None) -> Path | None:
    """Return the results to show: those given, or those that replay leaves."""
    if given is not None:
        return existing_file(given, "results")
    name = f"{path.stem}.results.mcap"
    return next((p for p in (path.with_name(name), Path(name)) if p.is_file()), None)


def _committed(path: Path, done: Done, out: Path) -> Done:
    from groundtrace_codecs.copies import copy_with_annotations

    damage = copy_with_annotations(path, out, done.annotations)
    if damage:
        print_stderr(f"{path.name}: {damage} damaged places are not in the copy")
    return replace(done, committed=out)


def _report(done: Done, asked: Changes, *, listed: bool, conflicts: bool, other: bool) -> None:
    """Print what was done, and what is asked to be listed."""
    for remark in done.remarks:
        print_stderr(remark)
    for line in _lines(done, undo=asked.undo):
        print_line(line)
    if listed or not (asked.anything or conflicts or other):
        _print_annotations(done)
    if conflicts:
        _print_conflicts(done)
    if done.committed is not None:
        count = len(done.annotations)
        print_line(f"wrote {done.committed}: {done.path.name} and, inside, its {count} annotations")


def _lines(done: Done, *, undo: bool) -> Iterator[str]:
    """Yield what was done as lines; ``undo`` says whether anything was to be taken back."""
    for file, merge in done.merges:
        added, clashes = len(merge.added), len(merge.conflicts)
        yield f"merged {file.name}: {added} added, {merge.same} known, {clashes} conflicts"
        for conflict in merge.conflicts:
            yield f"  {_conflict_text(done, conflict)}"
    for what, annotation in done.actions:
        yield f"{what} {annotation.id}: {_annotation_text(done, annotation)}"
    if undo:
        yield "undone: " + (done.undone or "nothing, there is no action left")


def _annotation_text(done: Done, annotation: Annotation) -> str:
    """Return an annotation as text."""
    label = annotation.label
    until = "" if label.end_ns is None else f" to {done.extent.seconds(label.end_ns):.3f}"
    words = " ".join(filter(None, (label.kind, label.label, label.channel)))
    return f"{words} at {done.extent.seconds(label.time_ns):.3f}{until} s by {label.author}"


def _conflict_text(done: Done, conflict: Conflict) -> str:
    """Return a conflict as text."""
    texts = " / ".join(f"{_annotation_text(done, a)} ({a.id})" for a in conflict.annotations)
    return f"{conflict.reason}: {texts}"


def _print_annotations(done: Done) -> None:
    if not done.annotations:
        print_line(f"{done.path.name}: no annotations")
        return
    header = ("id", "time [s]", "end [s]", "kind", "label", "channel", "author", "note")
    print_table(header, [_row(done, a) for a in done.annotations])


def _row(done: Done, annotation: Annotation) -> tuple[str, ...]:
    label = annotation.label
    end = "" if label.end_ns is None else f"{done.extent.seconds(label.end_ns):.3f}"
    note = " ".join(label.note.split())
    words = (label.kind, label.label, label.channel, label.author, note)
    return (annotation.id, f"{done.extent.seconds(label.time_ns):.3f}", end, *words)


def _print_conflicts(done: Done) -> None:
    conflicts = conflicts_of(done.annotations)
    print_line(f"{len(conflicts)} conflicts" if conflicts else "no conflicts")
    for conflict in conflicts:
        print_line(f"  {_conflict_text(done, conflict)}")
