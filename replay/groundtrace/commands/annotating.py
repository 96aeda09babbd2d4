"""``groundtrace annotate``."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from decimal import Decimal, InvalidOperation
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter, validators

from groundtrace_codecs.labels import Label
from groundtrace_codecs.signals import NS_PER_S

from ..annotate import Annotations, stored
from ..annotate.checks import AUTHOR, named
from ..errors import AnnotationError
from ..pipeline import checked_pipeline
from .annotation_lines import Done, print_annotations, print_conflicts, print_document
from .output import existing, progress, say, writable

if TYPE_CHECKING:
    from groundtrace_codecs.annotations import Annotation

    from ..annotate.checks import Extent

FLAG = Parameter(negative="")
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
    add: Annotated[list[str] | None, Parameter(negative="")] = None,
    label: str | None = None,
    channel: str | None = None,
    note: str | None = None,
    author: str = AUTHOR,
    edit: Annotated[tuple[str, str] | None, Parameter(negative="")] = None,
    delete: Annotated[list[str] | None, Parameter(negative="")] = None,
    undo: Annotated[bool, FLAG] = False,
    merge: Annotated[list[Path] | None, Parameter(negative="", consume_multiple=True)] = None,
    list_: Annotated[bool, Parameter(name="--list", negative="")] = False,
    conflicts: Annotated[bool, FLAG] = False,
    commit: Annotated[bool, FLAG] = False,
    out: Annotated[Path | None, Parameter(name=["--out", "-o"])] = None,
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
    from ..plugins import load, plugins

    if "annotate" not in {plugin.name for plugin in plugins("views")}:
        raise AnnotationError("--serve: expected an installed page (groundtrace.views), found none")
    return partial(load("views", "annotate"), report=say, progress=progress)


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
    from groundtrace_codecs.copying import copy_with_annotations

    damage = copy_with_annotations(path, out, done.annotations)
    if damage:
        say(f"{path.name}: {damage} damaged places are not in the copy")
    return replace(done, committed=out)


def _report(done: Done, asked: _Asked, *, listed: bool, conflicts: bool, other: bool) -> None:
    """Print what was done, and what is asked to be listed."""
    for remark in done.remarks:
        say(remark)
    for line in done.lines(undo=asked.undo):
        print(line)
    if listed or not (asked.anything or conflicts or other):
        print_annotations(done)
    if conflicts:
        print_conflicts(done)
    if done.committed is not None:
        count = len(done.annotations)
        print(f"wrote {done.committed}: {done.path.name} and, inside, its {count} annotations")
