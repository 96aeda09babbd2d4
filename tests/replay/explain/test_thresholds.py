from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from page_sessions import write_walk

from groundtrace.evaluation.matching import match_steps
from groundtrace.explain.redecide import OfflineDecider
from groundtrace.explain.thresholds import LEAST_VALUES, VALUES, threshold_curves, tried
from groundtrace.pipeline.results import evidence_of
from groundtrace_viewers.web.annotate import replayed

if TYPE_CHECKING:
    from groundtrace.pipeline.results import Evidence


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Evidence:
    folder = tmp_path_factory.mktemp("walk")
    return evidence_of(replayed(write_walk(folder / "walk.mcap"), None, "", folder)[1])


def test_each_value_says_what_a_replay_with_it_would(walk: Evidence) -> None:
    curves = threshold_curves(walk)
    assert curves
    for curve in curves:
        assert LEAST_VALUES <= len(curve.values) <= VALUES
        assert curve.now in curve.values
        for place in (0, len(curve.values) // 2, len(curve.values) - 1):
            setting = {(curve.stage, curve.parameter): curve.values[place]}
            times = OfflineDecider(walk).outcome(setting).step_times()
            found = match_steps(walk.labels, times, walk.start_ns, walk.end_ns)
            told = curve.right[place], curve.missed[place], curve.false[place]
            assert told == (len(found.pairs), len(found.missed), len(found.false))


def test_true_steps_are_right_or_missed(walk: Evidence) -> None:
    for curve in threshold_curves(walk):
        assert len({r + m for r, m in zip(curve.right, curve.missed, strict=True)}) == 1


def test_without_true_steps_there_is_nothing_to_count(walk: Evidence) -> None:
    assert threshold_curves(replace(walk, labels=())) == ()


def test_values_are_where_candidates_are_and_the_threshold_is_among_them() -> None:
    measured = np.array([np.nan, 1.0, 2.0, 3.0, 1000.0])
    found = tried(measured, 2.34567, 11, is_integer=False)
    assert 2.34567 in found
    assert found == sorted(found)
    assert (found[0], found[-1], len(found)) == (1.0, 1000.0, 11)
    assert tried(measured, 2.0, 11, is_integer=True)[:3] == [1.0, 2.0, 3.0]
    assert tried(np.array([np.nan]), 5.0, 11, is_integer=False) == [5.0]
