"""Changes of a recording's annotations, as a command asks for them, and what came of them."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from decimal import Decimal, InvalidOperation
from typing import TYPE_CHECKING, Any

import msgspec

from groundtrace_codecs.annotations import sidecar_path
from groundtrace_codecs.events import Label
from groundtrace_codecs.signals import NS_PER_S

from ..errors import AnnotationError
from .agreement import conflicts, document_of
from .store import Annotations, stored

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from groundtrace_codecs.annotations import Annotation, RecordingKey

    from .agreement import Conflict
    from .store import Extent, Merge

_MARK = re.compile(r"(?P<kind>[a-z]+)@(?P<from>[0-9.]+)(?:-(?P<to>[0-9.]+))?")


@dataclass(frozen=True, slots=True)
class Words:
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
class Changes:
    """What is to be changed, in this order.

    Attributes
    ----------
    merge
        Files of others' annotations to take in.
    add
        KIND@SECONDS or KIND@FROM-TO each.
    edit
        An id, and what it is said to be now.
    delete
        Ids.
    undo
        Whether the last action is taken back.
    words
        Of what is added or edited.
    """

    merge: Sequence[Path]
    add: Sequence[str]
    edit: tuple[str, str] | None
    delete: Sequence[str]
    undo: bool
    words: Words

    def __post_init__(self) -> None:
        """Refuse words without anything that they are said of."""
        words = self.words
        given = [f"--{name}" for name in words.__slots__ if getattr(words, name) is not None]
        if given and not self.add and self.edit is None:
            raise AnnotationError(f"{given[0]}: expected --add or --edit with it, found neither")

    @property
    def anything(self) -> bool:
        """Whether anything is."""
        return bool(self.merge or self.add or self.edit or self.delete or self.undo)


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


def unchanged(path: Path) -> Done:
    """Return the annotations of a recording as they are."""
    state = stored(path)
    return Done(path, state.key, state.extent, state.content.annotations, state.content.remarks)


def changed(path: Path, author: str, asked: Changes) -> Done:
    """Change the annotations of a recording, each action safe before the next.

    Parameters
    ----------
    path
        The recording.
    author
        Who annotates.
    asked
        What is to be changed.

    Raises
    ------
    AnnotationError
        Where a change is not possible; those before it are kept.
    """
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


def _edited(store: Annotations, id_: str, text: str, words: Words) -> Annotation:
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
    match = _MARK.fullmatch(text)
    try:
        if match is None:
            raise InvalidOperation
        times = [Decimal(t) for t in match.group("from", "to") if t is not None]
    except InvalidOperation as error:
        raise AnnotationError(
            f"{option}: expected KIND@SECONDS or KIND@FROM-TO, found {text[:40]!r}"
        ) from error
    # beyond any recording; the check of times then says so
    since_ns = [round(min(t, Decimal(10**9)) * NS_PER_S) for t in times]
    start_ns, end_ns = (extent.start_ns + ns for ns in (since_ns[0], since_ns[-1]))
    return Label(start_ns, match.group("kind"), end_ns if len(times) > 1 else None)


def document(done: Done, *, with_conflicts: bool) -> dict[str, Any]:
    """Return all of it as one JSON document, which ``--merge`` takes."""
    content: dict[str, Any] = msgspec.to_builtins(document_of(done.key, done.annotations))
    content |= {
        "sidecar": str(sidecar_path(done.path)),
        "actions": [{"action": what, "id": a.id} for what, a in done.actions],
        "undone": done.undone,
        "merged": [_merge(file, merge) for file, merge in done.merges],
        "committed": None if done.committed is None else str(done.committed),
        "remarks": list(done.remarks),
    }
    if with_conflicts:
        content["conflicts"] = [_conflict(c) for c in conflicts(done.annotations)]
    return content


def _merge(file: Path, merge: Merge) -> dict[str, object]:
    return {
        "file": file.name,
        "added": len(merge.added),
        "same": merge.same,
        "conflicts": [_conflict(c) for c in merge.conflicts],
    }


def _conflict(conflict: Conflict) -> dict[str, object]:
    return {"reason": conflict.reason, "ids": [a.id for a in conflict.annotations]}
