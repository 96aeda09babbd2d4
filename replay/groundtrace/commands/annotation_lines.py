"""What ``groundtrace annotate`` prints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import msgspec

from groundtrace_codecs.annotations import sidecar_path

from ..annotate import conflicts as conflicts_of
from ..annotate.exchange import document_of
from .output import print_json, print_table

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from groundtrace_codecs.annotations import Annotation, RecordingKey

    from ..annotate import Conflict, Merge
    from ..annotate.checks import Extent


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
