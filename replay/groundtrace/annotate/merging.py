"""Taking in what others annotated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from groundtrace_codecs.annotations import read_sidecar
from groundtrace_codecs.errors import CodecError

from ..errors import AnnotationError
from .agreement import Conflict, conflicts
from .checks import checked_annotation
from .exchange import from_json
from .journal import Change
from .reading import check_key

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence
    from pathlib import Path

    from groundtrace_codecs.annotations import Annotation, RecordingKey

    from .checks import Extent

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
        found, annotations = sidecar.key, sidecar.annotations
    else:
        found, annotations = from_json(content, key.start_ns, path.name)
    check_key(found, key, path.name)
    return tuple(checked_annotation(a, extent, path.name) for a in annotations)


def merged(
    items: Mapping[str, Annotation], known: Collection[str], others: Sequence[Annotation]
) -> Merge:
    """Compare annotations that came with those that are here.

    Parameters
    ----------
    items
        What is here, by id.
    known
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
    said = {a.label for a in items.values()}
    clashes: list[Conflict] = []
    same = 0
    for other in others:
        here = items.get(other.id) or added.get(other.id)
        if here is None and other.id in known:
            clashes.append(Conflict("deleted here", (other,)))
        elif here is not None and here.label != other.label:
            clashes.append(Conflict("edited", (here, other)))
        elif here is not None or other.label in said:
            same += 1
        else:
            added[other.id] = other
            said.add(other.label)
    everything = [*items.values(), *added.values()]
    clashes += [c for c in conflicts(everything) if any(a.id in added for a in c.annotations)]
    return Merge(tuple(added.values()), same, tuple(clashes))
