"""A change tried is the change decided from the start, on the whole and about a moment."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from groundtrace.errors import PipelineError
from groundtrace.explain.reasons import times_of
from groundtrace.explain.redecide import OfflineDecider, ParameterTrials
from groundtrace.explain.sweep import measure_evidence
from groundtrace.pipeline.config import load_pipeline
from groundtrace.simulate.recording import write
from groundtrace.simulate.room import simulate_room
from groundtrace.simulate.room_plan import RoomOptions

if TYPE_CHECKING:
    from pathlib import Path

CHANGES = (
    ("picks", "ratio", 9.0),
    ("steps", "min_channels", 8),
    ("picks", "refractory_s", 0.02),
    ("steps", "refractory_s", 0.9),
    ("picks", "ratio", 14.0),
)


@pytest.fixture(scope="module")
def redecider(tmp_path_factory: pytest.TempPathFactory) -> OfflineDecider:
    path: Path = tmp_path_factory.mktemp("tries") / "room.mcap"
    write(simulate_room(RoomOptions(duration_s=8.0, rate_hz=5000.0, snr=12.0)), path)
    return OfflineDecider(measure_evidence(path, load_pipeline("room-steps")))


def test_a_change_gives_the_steps_that_deciding_from_the_start_gives(redecider):
    tries = ParameterTrials(redecider)
    assert tries.stages == ("picks", "steps")
    assert np.array_equal(times_of(tries.unchanged()), redecider.outcome().step_times())
    given = set()
    for stage, parameter, value in CHANGES:
        found = times_of(tries.passed({(stage, parameter): value}))
        expected = redecider.outcome({(stage, parameter): value}).step_times()
        assert np.array_equal(found, expected), (stage, parameter)
        given.add(tuple(found.tolist()))
    assert len(given) >= 3


def test_about_a_moment_only_its_candidates_count(redecider):
    start_ns = redecider.evidence.start_ns
    span = (start_ns + 2 * 10**9, start_ns + 5 * 10**9)
    near = ParameterTrials(redecider).within(*span)
    for stage, parameter, value in CHANGES:
        found = times_of(near.passed({(stage, parameter): value}))
        expected = redecider.outcome({(stage, parameter): value}, span).step_times()
        assert np.array_equal(found, expected), (stage, parameter)
    assert len(times_of(near.unchanged())) > 0


def test_what_needs_a_replay_is_refused(redecider):
    with pytest.raises(PipelineError, match="stored floor"):
        ParameterTrials(redecider).passed({("picks", "ratio"): 0.5})
