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
#: Types of steps that are no foot's name: truth that uses one of them names types, not feet.
ALONG = frozenset({"forward", "backward"})
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


def truth_words(label: str, *, typed: bool = False) -> tuple[str, str]:
    """Return foot and kind of step that a label's text names, each perhaps empty.

    Parameters
    ----------
    label
        The text.
    typed
        Whether the truth names types of steps: left and right are types too then, and a foot only
        where they come before another type.
    """
    words = [word for word in re.split(r"[\s,;/]+", label.strip().lower()) if word]
    sides = [word for word in words if word in FEET]
    others = [word for word in words if word not in FEET]
    if typed and sides and not others:
        others, sides = sides[-1:], sides[:-1]
    return (sides[0] if sides else ""), " ".join(others)


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
    Confusion of feet and of kinds, each None where one side says nothing. The kind of a detected
    step is its type where it has one.
    """
    true = sorted((x for x in labels if x.kind == "step"), key=lambda x: x.time_ns)
    found = sorted(steps, key=lambda x: x.time_ns)
    rows = np.searchsorted([x.time_ns for x in true], matching.truth_ns[matching.pairs[:, 0]])
    columns = np.searchsorted([x.time_ns for x in found], matching.found_ns[matching.pairs[:, 1]])
    typed = any(ALONG & set(truth_words(x.label)[1].split()) for x in true)
    feet, kinds = [], []
    for i, j in zip(rows, columns, strict=True):
        foot, kind = truth_words(true[i].label, typed=typed)
        feet.append((foot, found[j].foot if found[j].foot in FEET else ""))
        kinds.append((kind, found[j].type or ("" if found[j].kind in PLAIN else found[j].kind)))
    return confusion(feet, FEET), confusion(kinds)
