"""What shipped pipelines make of short recordings is what it was, event by event."""

from __future__ import annotations

from importlib.resources import files
from typing import TYPE_CHECKING

import numpy as np
import pytest
from golden_events import CASES, GOLDEN, case_name, differences, encoded, golden, replayed

from groundtrace import kernels
from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import load_pipeline, named_pipelines

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture(scope="session")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which recordings are made once."""
    return tmp_path_factory.mktemp("golden")


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> set[str]:
    """The compiled files that are asked for from now on."""
    load, names = kernels.__getattr__, set()
    monkeypatch.setattr(kernels, "__getattr__", lambda name: names.add(name) or load(name))
    for name in kernels.__all__:  # as if none was asked for yet
        vars(kernels).pop(name, None)
    return names


@pytest.mark.parametrize(("recording", "pipeline"), CASES, ids=[case_name(*c) for c in CASES])
def test_events_are_golden(
    recordings: Path, recording: str, pipeline: str, asked: set[str]
) -> None:
    found = replayed(recordings, recording, pipeline)
    assert differences(golden(recording, pipeline), found) == []
    if pipeline in named_pipelines():  # its stages name the compiled files that they run
        assert asked <= build_pipeline(load_pipeline(pipeline)).compiles


def test_every_shipped_pipeline_has_golden_events() -> None:
    shipped = {path.name for path in (files("groundtrace") / "pipelines").iterdir()}
    own = {path.name for path in GOLDEN.glob("*.toml")}
    assert {f"{pipeline}.toml" for _, pipeline in CASES} == shipped | own
    assert {path.stem for path in GOLDEN.glob("*.npz")} == {case_name(*case) for case in CASES}
    assert sum(path.stat().st_size for path in GOLDEN.iterdir()) < 1_000_000


def test_two_replays_give_the_same_events_byte_for_byte(recordings: Path) -> None:
    one, other = (encoded(replayed(recordings, "two", "room-two-walkers")) for _ in range(2))
    assert one == other


@pytest.mark.parametrize(
    ("recording", "pipeline", "setting"),
    [
        ("two", "room-steps", "steps.min_channels=5"),
        ("types", "step-types", "types.window=0.05"),
        ("waist-walk", "pedestrian-waypoints", "track.weinberg=0.380001"),
    ],
)
def test_a_setting_that_is_changed_is_noticed(
    recordings: Path, recording: str, pipeline: str, setting: str
) -> None:
    found = replayed(recordings, recording, pipeline, setting)
    assert differences(golden(recording, pipeline), found)


def test_a_nanosecond_and_a_verdict_are_noticed_and_numbers_from_a_millionth_on() -> None:
    expected = golden("two", "room-steps")
    times, accepted = "Pick/picks/time_ns", "CandidateBlock/picks/accepted"
    values = "CandidateBlock/picks/value"
    count = len(expected[times])
    (line,) = differences(expected, expected | {times: expected[times] + (np.arange(count) == 3)})
    assert line.startswith(f"{times}: 1 of {count} differ, first row 3: expected ")
    assert differences(expected, expected | {accepted: ~expected[accepted]})
    nearly = expected[values].astype(np.float64)
    assert differences(expected, expected | {values: nearly * (1 + 2e-6)})
    assert not differences(expected, expected | {values: nearly * (1 + 5e-7)})
    assert differences(expected, {k: v for k, v in expected.items() if k != accepted})
