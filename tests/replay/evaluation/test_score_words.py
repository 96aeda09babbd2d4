"""Left or right, and kinds of steps, of the matched ones."""

from __future__ import annotations

import pytest

from groundtrace.evaluation.report import score_events
from groundtrace.evaluation.steps import confusion, truth_words
from groundtrace_codecs.events import Label, StepEvent

SECOND = 10**9


def true_step(second: int, label: str = "") -> Label:
    return Label(second * SECOND, "step", label=label)


def found_step(second: int, foot: str = "", kind: str = "step", late_ms: int = 20) -> StepEvent:
    return StepEvent(second * SECOND + late_ms * 10**6, kind, foot, "/imu", "steps", 1.0)


@pytest.mark.parametrize(
    ("label", "expected"),
    [
        ("left", ("left", "")),
        ("Right, stairs up", ("right", "stairs up")),
        ("forward;left", ("left", "forward")),
        ("", ("", "")),
    ],
)
def test_a_label_names_foot_and_kind_in_any_order(label: str, expected: tuple[str, str]) -> None:
    assert truth_words(label) == expected


def test_feet_are_compared_where_both_sides_name_one() -> None:
    truth = [
        true_step(1, "left"),
        true_step(2, "right"),
        true_step(3, "left"),
        true_step(4),
        true_step(5, "left"),
    ]
    found = [found_step(5), found_step(1, "left"), found_step(2, "left"), found_step(4, "left")]
    score = score_events(truth, found, 0, 6 * SECOND)
    assert score.steps is not None
    assert score.steps.kinds is None
    feet = score.steps.feet
    assert feet is not None
    assert (feet.words, feet.counts) == (["left", "right"], [[1, 0], [1, 0]])
    assert (feet.compared, feet.agreed, feet.accuracy) == (2, 1, 0.5)


def test_kinds_are_a_confusion_matrix_of_matched_steps() -> None:
    kinds = [("forward", "forward"), ("forward", "stairs"), ("stairs", "stairs"), ("turn", "step")]
    truth = [true_step(k, a) for k, (a, _) in enumerate(kinds)] + [true_step(9, "forward")]
    found = [found_step(k, kind=b) for k, (_, b) in enumerate(kinds)]
    score = score_events(truth, found, 0, 9 * SECOND)
    assert score.steps is not None
    assert score.steps.feet is None
    assert score.steps.kinds is not None
    assert score.steps.kinds.words == ["forward", "stairs"]
    assert score.steps.kinds.counts == [[1, 1], [0, 1]]
    assert score.steps.kinds.accuracy == pytest.approx(2 / 3)


def test_steps_in_ignored_time_say_nothing() -> None:
    truth = [true_step(1, "left"), true_step(3, "left"), Label(2 * SECOND, "ignore", 4 * SECOND)]
    score = score_events(truth, [found_step(1, "left"), found_step(3, "right")], 0, 5 * SECOND)
    assert score.steps is not None
    assert score.steps.feet is not None
    assert score.steps.feet.counts == [[1, 0], [0, 0]]


def test_without_words_there_is_no_matrix() -> None:
    assert confusion([("left", ""), ("", "left")]) is None
    assert confusion([]) is None
