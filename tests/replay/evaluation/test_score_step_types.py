"""Types of matched steps against the truth's, as a confusion matrix."""

from __future__ import annotations

import pytest

from groundtrace.evaluation.report import score_events
from groundtrace.evaluation.steps import truth_words
from groundtrace_codecs.events import Label, StepEvent

SECOND = 10**9


@pytest.mark.parametrize(
    ("label", "expected"),
    [
        ("left", ("", "left")),
        ("forward", ("", "forward")),
        ("left forward", ("left", "forward")),
        ("backward, right", ("right", "backward")),
        ("right left", ("right", "left")),
        ("", ("", "")),
    ],
)
def test_where_truth_names_types_left_and_right_are_types(
    label: str, expected: tuple[str, str]
) -> None:
    assert truth_words(label, typed=True) == expected


def test_types_are_a_confusion_matrix_and_feet_are_not_mistaken_for_them() -> None:
    pairs = [("forward", "forward"), ("left", "left"), ("right", "forward"), ("right", "")]
    truth = [Label(k * SECOND, "step", label=a) for k, (a, _) in enumerate(pairs)]
    found = [
        StepEvent(k * SECOND, "step", "right", "/imu", "types", 1.0, type=b)
        for k, (_, b) in enumerate(pairs)
    ]
    steps = score_events(truth, found, 0, 5 * SECOND).steps
    assert steps is not None
    assert steps.feet is None
    assert steps.kinds is not None
    assert steps.kinds.words == ["forward", "left", "right"]
    assert steps.kinds.counts == [[1, 0, 0], [0, 1, 0], [1, 0, 0]]


def test_feet_alone_stay_feet() -> None:
    truth = [Label(SECOND, "step", label="left")]
    found = [StepEvent(SECOND, "step", "left", "/imu", "types", 1.0, type="forward")]
    steps = score_events(truth, found, 0, 2 * SECOND).steps
    assert steps is not None
    assert steps.kinds is None
    assert steps.feet is not None
    assert steps.feet.agreed == 1
