"""Left or right, and what kind of step: what is said of matched steps, as confusion matrices."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from groundtrace_codecs.events import StepEvent
    from groundtrace_codecs.labels import Label

    from .step_matching import StepMatch

FEET = ("left", "right")
#: Kinds of a detected step that say nothing of how it was made.
PLAIN = frozenset({"", "step", "impact"})


@dataclass(frozen=True, slots=True)
class Confusion:
    """What truth and detections say of the same steps.

    Attributes
    ----------
    words
        Names of the rows and columns.
    counts
        Matched steps; rows are what truth says, columns what the detection says.
    compared
        Matched steps of which both say something.
    agreed, accuracy
        Those of which both say the same, and their part.
    """

    words: list[str]
    counts: list[list[int]]
    compared: int
    agreed: int
    accuracy: float


def confusion(pairs: Sequence[tuple[str, str]], words: Sequence[str] = ()) -> Confusion | None:
    """Count pairs (truth, detection) of words.

    Parameters
    ----------
    pairs
        Pairs with an empty word are left out.
    words
        Names of rows and columns; those that occur, sorted, where empty.

    Returns
    -------
    The matrix, or None where there is nothing to compare.
    """
    said = [(a, b) for a, b in pairs if a and b]
    if not said:
        return None
    names = list(words) or sorted({word for pair in said for word in pair})
    counts = np.zeros((len(names), len(names)), np.int64)
    for a, b in said:
        counts[names.index(a), names.index(b)] += 1
    agreed = int(np.trace(counts))
    return Confusion(names, counts.tolist(), len(said), agreed, agreed / len(said))


def truth_words(label: str) -> tuple[str, str]:
    """Return foot and kind of step that a label's text names, each perhaps empty."""
    words = re.split(r"[\s,;/]+", label.strip().lower())
    foot = next((word for word in words if word in FEET), "")
    return foot, " ".join(word for word in words if word not in FEET)


def compare_words(
    labels: Sequence[Label], steps: Sequence[StepEvent], matching: StepMatch
) -> tuple[Confusion | None, Confusion | None]:
    """Compare what truth and detections say of the matched steps.

    Parameters
    ----------
    labels
        The truth.
    steps, matching
        The detections, any order, and how they were matched.

    Returns
    -------
    Confusion of feet and of kinds, each None where one side says nothing.
    """
    true = sorted((x for x in labels if x.kind == "step"), key=lambda x: x.time_ns)
    found = sorted(steps, key=lambda x: x.time_ns)
    rows = np.searchsorted([x.time_ns for x in true], matching.truth_ns[matching.pairs[:, 0]])
    columns = np.searchsorted([x.time_ns for x in found], matching.found_ns[matching.pairs[:, 1]])
    feet, kinds = [], []
    for i, j in zip(rows, columns, strict=True):
        foot, kind = truth_words(true[i].label)
        feet.append((foot, found[j].foot if found[j].foot in FEET else ""))
        kinds.append((kind, "" if found[j].kind in PLAIN else found[j].kind))
    return confusion(feet, FEET), confusion(kinds)
