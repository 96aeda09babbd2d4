"""Compares what two replays decided of a span."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace.pipeline.engine import part_of
from groundtrace_codecs.events import SMOOTHED, CandidateBlock, Gap, Note, StageSpec, TraceBlock

if TYPE_CHECKING:
    from collections.abc import Sequence

    from groundtrace_codecs.events import Event

#: Values may differ by the rounding of float32, in which they are stored.
ROUNDING = 1e-6


def assert_same_span(
    whole: Sequence[Event], part: Sequence[Event], start_ns: int | None, stop_ns: int | None
) -> int:
    """Compare what was decided of a span; return how many candidates there are."""
    one, other = (_columns(events, start_ns, stop_ns) for events in (whole, part))
    assert one.keys() == other.keys()
    for key, columns in one.items():
        for field, values in columns.items():
            found = other[key][field]
            assert values.shape == found.shape, (key, field)
            if values.dtype.kind == "f":
                assert np.allclose(values, found, ROUNDING, 0, equal_nan=True), (key, field)
            else:
                assert np.array_equal(values, found), (key, field)
    return sum(len(columns["accepted"]) for columns in one.values() if "accepted" in columns)


def _columns(
    events: Sequence[Event], start_ns: int | None, stop_ns: int | None
) -> dict[tuple[str, str], dict[str, Any]]:
    found: dict[tuple[str, str], list[Any]] = {}
    for event in events:
        part = part_of(event, start_ns, stop_ns)
        if part is None or isinstance(part, Note | StageSpec | Gap):
            continue
        stage = part.spec.stage if isinstance(part, CandidateBlock | TraceBlock) else part.stage
        if stage.endswith(SMOOTHED):  # all of a track counts in it
            continue
        found.setdefault((stage, type(part).__name__), []).append(part)
    columns = {}
    for key, parts in found.items():
        names = ["time_ns"]
        if isinstance(parts[0], CandidateBlock):
            names += ["channel", "value", "accepted"]
        elif isinstance(parts[0], TraceBlock):
            names += ["value"]
        columns[key] = {
            n: np.concatenate([np.atleast_1d(getattr(p, n)) for p in parts]) for n in names
        }
        if hasattr(parts[0], "end_ns"):  # what lasts, as far as it lasts in the span
            ends = np.array([part.end_ns for part in parts], np.int64)
            columns[key]["end_ns"] = ends if stop_ns is None else np.minimum(ends, stop_ns)
    return columns
