"""Headings and disturbances on real trials, by the shipped maps and the shipped pipeline."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from groundtrace.evaluation.report import Score, score_events
from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import load_pipeline
from groundtrace.pipeline.source import Source
from groundtrace_codecs.importers.run import import_recording
from groundtrace_codecs.recording import Recording
from groundtrace_recordings import map_path

if TYPE_CHECKING:
    from pathlib import Path


def scored(source: Path, folder: Path) -> Score:
    name = "broad-mat.toml" if source.suffix == ".mat" else "broad-hdf5.toml"
    out = folder / "trial.mcap"
    import_recording([source], out, map_path=map_path(name))
    with Recording.open(out) as recording:
        chain = build_pipeline(load_pipeline("heading"))
        events = [e for item in Source(recording) for e in chain.process(item)]
        events += chain.flush()
        return score_events(recording.labels, events, recording.start_ns, recording.end_ns)


def trial(data: Path, number: str) -> Path:
    found = sorted((data / "broad").glob(f"{number}_*"))
    if not found:
        pytest.skip(f"BROAD trial {number} is absent")
    return found[0]


def test_a_magnet_on_the_sensor_is_found_and_the_heading_kept(data: Path, tmp_path: Path) -> None:
    score = scored(trial(data, "32"), tmp_path)
    assert score.heading is not None
    assert score.disturbance is not None
    assert score.heading.rmse_deg is not None
    assert score.heading.rmse_deg < 2.5
    assert score.disturbance.f1 > 0.95


def test_an_undisturbed_trial_has_no_disturbance(data: Path, tmp_path: Path) -> None:
    score = scored(trial(data, "02"), tmp_path)
    assert score.heading is not None
    assert score.heading.rmse_deg is not None
    assert score.heading.rmse_deg < 2.5
    assert score.disturbance is not None
    assert score.disturbance.truth_s == score.disturbance.false_alarm_s == 0.0
    assert score.disturbance.f1 is None


def test_a_field_that_changes_with_the_place_is_no_disturbance(data: Path, tmp_path: Path) -> None:
    # it wanders by 3.9 uT about its median, and begins 2.9 uT off
    score = scored(trial(data, "10"), tmp_path)
    assert score.disturbance is not None
    assert score.disturbance.truth_s == 0.0
    assert score.disturbance.false_alarm_s < 0.5


def test_a_magnet_beside_the_way_is_found_and_left_behind(data: Path, tmp_path: Path) -> None:
    score = scored(trial(data, "29"), tmp_path)
    assert score.disturbance is not None
    assert score.disturbance.f1 is not None
    assert score.disturbance.f1 > 0.92
