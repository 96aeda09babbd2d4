"""Step detectors on the body, on walks of others: waist against contacts, foot against strides."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from groundtrace.evaluation.matching import match_steps
from groundtrace.pipeline.conformance import Outcome, run
from groundtrace.pipeline.parameters import StageConfig
from groundtrace.pipeline.plugins import load
from groundtrace.pipeline.source import Source
from groundtrace.pipeline.stage import StageRunner
from groundtrace_codecs.importers.run import import_recording
from groundtrace_codecs.recording import Recording
from groundtrace_recordings import map_path

if TYPE_CHECKING:
    from pathlib import Path

    from groundtrace_codecs.events import Label


def imported(source: Path, folder: Path, columns: str) -> tuple[list, list[Label], int, int]:
    """Items, truth, start and end of a recording of others."""
    path = folder / "rec.mcap"
    import_recording([source], path, map_path=map_path(columns))
    with Recording.open(path) as recording:
        items = list(Source(recording, block_s=60.0))
        return items, list(recording.labels), recording.start_ns, recording.end_ns


def detected(name: str, items: list) -> Outcome:
    kind = load("stages", name)
    return run(StageRunner(StageConfig(name, "steps"), kind, kind.Parameters()), items)


def test_belief_and_swing_find_most_contacts_of_a_waist(data: Path, tmp_path: Path) -> None:
    source = data / "mobgap" / "HA" / "001" / "data.mat"
    items, truth, start_ns, end_ns = imported(source, tmp_path, "mobgap-test11.toml")
    for name in ("dstp", "rest-swing"):
        found = detected(name, items)
        matching = match_steps(truth, found.times[found.accepted], start_ns, end_ns, 0.12)
        f1 = 2 * len(matching.pairs) / (len(matching.truth_ns) + len(matching.found_ns))
        assert f1 >= 0.85, name  # a metronome of the same count reaches .36


def test_every_stride_of_a_foot_is_found_by_its_stance(data: Path, tmp_path: Path) -> None:
    source = data / "xio-gait" / "short_walk.csv"
    items, *_ = imported(source, tmp_path, "xio-gait.toml")
    found = detected("zupt", items)
    # the angular rate has 16 groups of push-off and swing, the first at 15.7 s, the last at 33.2 s
    times = (found.times[found.accepted] - items[0].start_ns) / 1e9
    assert len(times) == 16
    assert 15.7 < times[0] < 16.9
    assert 33.2 < times[-1] < 34.5
    assert found.values[-1, 1] == pytest.approx(7.9, abs=0.3)  # it stands until the end
