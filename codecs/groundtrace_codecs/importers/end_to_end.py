"""Files that each hold one event, or one part of a recording, as one recording.

Files that tell different times keep them: a hammer shot its acquisition time, a table its clock.
Where their times overlap, as those of files do that each begin at 0, they tell nothing, and the
files are laid end to end in order, with a second of nothing between two so that a replay starts
each with fresh state.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from ..errors import SchemaError
from ..signals import NS_PER_S, SignalBlock, Stream
from .api import Imported

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..labels import Label
    from .api import Source

#: Time without samples between two files that are laid end to end [s].
GAP_S = 1.0


@dataclass(frozen=True, slots=True)
class Part:
    """What one file takes of the time.

    Attributes
    ----------
    name
        Of the file.
    start_ns, end_ns
        First sample and one period after the last, by the file's own time [ns].
    """

    name: str
    start_ns: int
    end_ns: int


@dataclass(frozen=True, slots=True)
class Laid:
    """Where files lie in one recording.

    Attributes
    ----------
    order
        Of the files, by their places in what was given.
    starts_ns
        First sample of each file, in that order [ns].
    note
        One line: whose times these are.
    own
        True where these are the files' own times.
    """

    order: tuple[int, ...]
    starts_ns: tuple[int, ...]
    note: str
    own: bool


def lay_out(parts: Sequence[Part], what: str, gap_s: float = GAP_S) -> Laid:
    """Return where files lie: at their own times, or end to end where these overlap.

    Parameters
    ----------
    parts
        The files, at least one, in the order to lay them in.
    what
        What a file is, for the note, such as ``shots``.
    gap_s
        Time between two that are laid end to end [s].
    """
    order = sorted(range(len(parts)), key=lambda i: parts[i].start_ns)
    for before, after in pairwise(order):
        if parts[after].start_ns < parts[before].end_ns:
            names = f"{parts[before].name} and {parts[after].name}"
            break
    else:
        starts = tuple(parts[i].start_ns for i in order)
        note = f"{len(parts)} {what}: each keeps its own time"
        return Laid(tuple(order), starts, note, own=True)
    starts_ns = [parts[0].start_ns]
    for part in parts[:-1]:
        starts_ns.append(starts_ns[-1] + part.end_ns - part.start_ns + round(gap_s * NS_PER_S))
    apart = f"{gap_s:g} s apart" if gap_s else "without a gap"
    return Laid(
        tuple(range(len(parts))),
        tuple(starts_ns),
        f"{len(parts)} {what}: laid end to end, {apart}: the times of {names} overlap",
        own=False,
    )


def one_recording(
    found: Sequence[Imported], names: Sequence[str], *, continuous: bool = False
) -> Imported:
    """Return what several files of one map hold as one recording, each with its labels.

    Parameters
    ----------
    found
        What each file holds: the same topics and channels.
    names
        Of the files.
    continuous
        True: the files are parts of one recording, each goes on where the one before ends.

    Raises
    ------
    SchemaError
        Where the files differ in rate so much that one of them is no recording of the same device.
    """
    from .mapped import sample_format

    if len(found) == 1:
        return found[0]
    read = [[(s, list(blocks)) for s, _, blocks in each.sources] for each in found]
    parts = [
        Part(name, each.start_ns, max(b.end_ns for _, blocks in streams for b in blocks))
        for name, each, streams in zip(names, found, read, strict=True)
    ]
    laid = lay_out(parts, "files", 0.0 if continuous else GAP_S)
    shifts = [
        start - parts[i].start_ns for i, start in zip(laid.order, laid.starts_ns, strict=True)
    ]
    sources: list[Source] = []
    for at in range(len(read[0])):
        stream = _common([read[i][at][0] for i in laid.order], [names[i] for i in laid.order])
        blocks = [
            shifted(block, stream, by_ns, laid.starts_ns[0])
            for i, by_ns in zip(laid.order, shifts, strict=True)
            for block in read[i][at][1]
        ]
        form, samples = sample_format(np.concatenate([b.samples for b in blocks]).astype(float))
        ends = np.cumsum([len(b) for b in blocks]).tolist()
        cut = [
            replace(b, samples=samples[end - len(b) : end])
            for b, end in zip(blocks, ends, strict=True)
        ]
        sources.append((stream, form, cut))
    return Imported(
        sources=tuple(sources),
        start_ns=laid.starts_ns[0],
        labels=tuple(
            later(label, by_ns)
            for i, by_ns in zip(laid.order, shifts, strict=True)
            for label in found[i].labels
        ),
        metadata=_records(found, names),
        warnings=tuple(dict.fromkeys(w for each in found for w in each.warnings)),
        remarks=(laid.note, *dict.fromkeys(r for each in found for r in each.remarks)),
        files=tuple((names[i], start) for i, start in zip(laid.order, laid.starts_ns, strict=True)),
    )


def later(label: Label, by_ns: int) -> Label:
    """Return the same label ``by_ns`` later."""
    end_ns = None if label.end_ns is None else label.end_ns + by_ns
    return replace(label, time_ns=label.time_ns + by_ns, end_ns=end_ns)


def shifted(block: SignalBlock, stream: Stream, by_ns: int, origin_ns: int) -> SignalBlock:
    """Return a block of ``stream`` ``by_ns`` later, counted from the stream's origin.

    A block of an irregular stream carries the times of its samples.
    """
    if stream.irregular:
        return SignalBlock(stream, origin_ns, 0, block.samples, block.sample_times() + by_ns)
    begin_ns = block.start_ns + by_ns
    first = round((begin_ns - origin_ns) * stream.rate_hz / NS_PER_S)
    anchor_ns = begin_ns - round(first * NS_PER_S / stream.rate_hz)
    return SignalBlock(stream, anchor_ns, first, block.samples)


def _common(streams: Sequence[Stream], names: Sequence[str]) -> Stream:
    """Return the stream that all are: of one rate, or irregular where their rates differ."""
    first = streams[0]
    for stream, name in zip(streams, names, strict=True):
        if not 0.5 < stream.rate_hz / first.rate_hz < 2:
            raise SchemaError(
                f"{name}: {stream.topic}: expected about {first.rate_hz:g} Hz as in {names[0]}, "
                f"found {stream.rate_hz:g} Hz"
            )
    if all(s.rate_hz == first.rate_hz and not s.irregular for s in streams):
        return first
    rate_hz = float(np.median([s.rate_hz for s in streams]))
    return replace(first, rate_hz=rate_hz, irregular=True)


def _records(found: Sequence[Imported], names: Sequence[str]) -> dict[str, dict[str, str]]:
    """Return the metadata of all files; of several with one key, each says its file."""
    records: dict[str, dict[str, str]] = {}
    for each, name in zip(found, names, strict=True):
        for record, pairs in each.metadata.items():
            kept = records.setdefault(record, {})
            for key, text in pairs.items():
                line = f"{name}: {text}"
                kept[key] = f"{kept[key]}; {line}" if key in kept else line
    return records
