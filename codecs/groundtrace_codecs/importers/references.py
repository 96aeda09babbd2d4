"""Reference events inside a source file, as its map's ``[[truth]]`` tables describe them.

Reference systems miss contacts and report one twice. Nothing is dropped silently: around a
contact known to be missing there is an ``ignore`` span, and events nearer to each other than
``min_interval_s`` become one with a warning.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import SchemaError
from ..labels import Label
from ..signals import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from .api import TruthMap

_UNITS_S = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
#: Times are further from the first sample than this in no file [s].
_LONGEST_S = 2**62 / NS_PER_S


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """Where reference events are looked up.

    Attributes
    ----------
    name
        Of the file, for messages.
    start_ns
        Time of the recording's first sample [ns].
    sample_times_ns
        Of the first stream, shape (n,) [ns].
    numbers, groups
        Look up a column, or a path with one entry for each bout.
    """

    name: str
    start_ns: int
    sample_times_ns: NDArray[np.int64]
    numbers: Callable[[str | int], NDArray[np.float64]]
    groups: Callable[[str], list[Any]]


def references(
    reference: Reference, truths: Sequence[TruthMap]
) -> tuple[tuple[Label, ...], tuple[str, ...]]:
    """Return the labels of all ``[[truth]]`` tables in time order, and warnings.

    Raises
    ------
    SchemaError
        Where a path leads nowhere, or a time is missing that may not be.
    """
    labels: list[Label] = []
    warnings: list[str] = []
    for truth in truths:
        if truth.increments_of is not None:
            labels += _increments(reference, truth)
        elif truth.total_of is not None:
            labels += _total(reference, truth)
        else:
            for bout in _bouts(reference, truth):
                found, remarks = _rules(bout, truth, reference)
                labels += found
                warnings += remarks
    return tuple(sorted(labels, key=lambda label: (label.time_ns, label.kind))), tuple(warnings)


def _increments(reference: Reference, truth: TruthMap) -> list[Label]:
    """Return one event for each unit a running count grows by, at the row where it does."""
    assert truth.increments_of is not None
    counts = reference.numbers(truth.increments_of)
    known = np.flatnonzero(np.isfinite(counts))
    if len(counts) != len(reference.sample_times_ns) or not known.size:
        raise SchemaError(
            f"{reference.name}: {truth.increments_of}: expected a count in the rows of the first "
            f"stream, found {len(counts)} cells"
        )
    grown = np.diff(counts[known])
    rows = np.repeat(known[1:], np.maximum(grown, 0).astype(np.int64))
    return [Label(int(t), truth.kind) for t in reference.sample_times_ns[rows]]


def _total(reference: Reference, truth: TruthMap) -> list[Label]:
    """Return the count over the whole recording, its end one period after the last sample."""
    assert truth.total_of is not None
    cells = reference.numbers(truth.total_of)
    found = cells[np.isfinite(cells)]
    if found.size != 1:
        raise SchemaError(
            f"{reference.name}: {truth.total_of}: expected one filled cell, found {found.size}"
        )
    times = reference.sample_times_ns
    end_ns = int(times.max()) + int(np.median(np.diff(times)))
    return [Label(int(times.min()), truth.kind, end_ns, value=float(found[0]))]


def _bouts(reference: Reference, truth: TruthMap) -> list[list[Label | None]]:
    """Return the events of each bout, None where the reference has no time."""
    assert truth.time is not None
    times = reference.groups(truth.time)
    columns = {
        name: reference.groups(path)
        for name in ("end", "label", "value", "x", "y")
        if (path := getattr(truth, name)) is not None
    }
    bouts = []
    for b, bout in enumerate(times):
        cells = {
            name: np.atleast_1d(groups[b])
            if name == "label"
            else _numbers(groups[b], reference, getattr(truth, name))
            for name, groups in columns.items()
        }
        moments = _numbers(bout, reference, truth.time)
        wrong = [n for n, c in cells.items() if len(c) != len(moments)]
        if wrong:
            raise SchemaError(
                f"{reference.name}: {getattr(truth, wrong[0])}: expected {len(moments)} cells, "
                f"found {len(cells[wrong[0]])}"
            )
        bouts.append(
            [
                _label(truth, reference, float(t), {n: c[i] for n, c in cells.items()})
                for i, t in enumerate(moments)
            ]
        )
    return bouts


def _numbers(cells: Any, reference: Reference, path: str) -> NDArray[np.float64]:
    try:
        return np.atleast_1d(np.asarray(cells, np.float64)).ravel()
    except (ValueError, TypeError) as error:
        raise SchemaError(f"{reference.name}: {path}: expected numbers, found: {error}") from error


def _label(
    truth: TruthMap, reference: Reference, time: float, cells: dict[str, Any]
) -> Label | None:
    """Return one event, or None where its time is NaN."""
    ends = [float(cells["end"])] if "end" in cells else []
    if not np.isfinite([time, *ends]).all():
        return None
    number = {n: float(cells[n]) for n in ("value", "x", "y") if n in cells}
    return Label(
        time_ns=_moment(truth, reference, time),
        kind=truth.kind,
        end_ns=_moment(truth, reference, ends[0]) if ends else None,
        x_m=number["x"] * truth.x_scale if "x" in number else None,
        y_m=number["y"] * truth.y_scale if "y" in number else None,
        value=number.get("value"),
        label=str(cells.get("label", "")).strip().lower(),
    )


def _moment(truth: TruthMap, reference: Reference, time: float) -> int:
    """Return a time of the file on the recording's clock [ns]."""
    if truth.unit != "sample":
        later_s = time * _UNITS_S[truth.unit]
        if abs(later_s) > _LONGEST_S:
            raise SchemaError(
                f"{reference.name}: {truth.time}: expected a time within 146 years, found {time:g}"
            )
        return reference.start_ns + round(later_s * NS_PER_S)
    index = round(time)
    if not 0 <= index < len(reference.sample_times_ns):
        raise SchemaError(
            f"{reference.name}: {truth.time}: expected a sample below "
            f"{len(reference.sample_times_ns)}, found {index}"
        )
    return int(reference.sample_times_ns[index])


def _rules(
    bout: list[Label | None], truth: TruthMap, reference: Reference
) -> tuple[list[Label], list[str]]:
    """Return a bout's events after merging, with ``ignore`` where one is known to be missing."""
    if truth.missing == "error" and None in bout:
        raise SchemaError(f"{reference.name}: {truth.time}: expected times, found NaN")
    kept: list[Label] = []
    ignored: list[Label] = []
    warnings: list[str] = []
    missing = False
    for event in bout:
        if event is None:
            missing = True
            continue
        last = kept[-1] if kept else None
        if last is not None and _near(last, event, truth):
            kept[-1], warning = _merge(last, event, reference)
            warnings.append(warning)
            continue
        if last is not None and (missing or _same_foot(last, event, truth)):
            why = "no time for a contact" if missing else f"two contacts {event.label} in a row"
            ignored += _ignore(last, event, truth, why)
        missing = False
        kept.append(event)
    return kept + ignored, warnings + [_told(label, reference) for label in ignored]


def _near(last: Label, event: Label, truth: TruthMap) -> bool:
    return event.time_ns - last.time_ns < truth.min_interval_s * NS_PER_S


def _same_foot(last: Label, event: Label, truth: TruthMap) -> bool:
    return truth.alternating and last.label == event.label != ""


def _merge(last: Label, event: Label, reference: Reference) -> tuple[Label, str]:
    """Return two events too near to be two as one; its foot is known only where they agree."""
    apart_ms = (event.time_ns - last.time_ns) / 1e6
    at_s = (last.time_ns - reference.start_ns) / NS_PER_S
    note = f"two in the reference, {apart_ms:g} ms apart"
    foot = last.label if last.label == event.label else ""
    return (
        replace(last, label=foot, note=note),
        f"{last.kind} at {at_s:.3f} s: {note}: taken as one",
    )


def _ignore(last: Label, event: Label, truth: TruthMap, why: str) -> list[Label]:
    margin_ns = round(truth.margin_s * NS_PER_S)
    span = (last.time_ns + margin_ns, event.time_ns - margin_ns)
    return [Label(span[0], "ignore", span[1], note=why)] if span[0] < span[1] else []


def _told(label: Label, reference: Reference) -> str:
    assert label.end_ns is not None
    span = [(t - reference.start_ns) / NS_PER_S for t in (label.time_ns, label.end_ns)]
    return f"ignore {span[0]:.3f} to {span[1]:.3f} s: {label.note} in the reference"
