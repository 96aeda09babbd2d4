"""The commands on recordings of vehicles, as a new user runs them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from command_runs import check_schema, done

if TYPE_CHECKING:
    from pathlib import Path

Capture = pytest.CaptureFixture[str]


def checked(capsys: Capture, command: str, *words: str) -> Any:
    """Run a command with --json; return its document, held to the schema."""
    document = done(capsys, command, *words, "--json").document
    check_schema(command, document)
    return document


@pytest.fixture(autouse=True)
def in_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_a_car_among_antennas_is_tracked_without_being_told_how(capsys: Capture) -> None:
    done(capsys, "simulate", "vehicle", "-o", "car.mcap")
    replayed = checked(capsys, "replay", "car.mcap", "--no-viewer")
    assert replayed["pipeline"] == "vehicle-tracks"
    scored = checked(capsys, "score", "car.results.mcap")
    assert scored["track"]["ways"]["across_median_m"] < 1
    why = checked(capsys, "why", "car.results.mcap")
    assert (why["right"], why["missed"], why["false"]) == (1, 0, 0)
    moment = checked(capsys, "why", "car.results.mcap", "--at", "14")
    assert {link["stage"] for link in moment["chain"]} >= {"presence", "course"}


def test_cars_beside_stations_pass_and_a_threshold_that_hides_them_is_named(
    capsys: Capture,
) -> None:
    options = ("--layout", "stations", "--duration-s", "40")
    done(capsys, "simulate", "vehicle", "-o", "road.mcap", *options)
    assert checked(capsys, "replay", "road.mcap", "--no-viewer")["pipeline"] == "vehicle-passes"
    assert checked(capsys, "score", "road.results.mcap")["passes"]["matched"] == 3
    assert "direction" in done(capsys, "score", "road.results.mcap").out
    high = ("road.mcap", "--no-viewer", "--out", "high.mcap", "--set", "passes.prominence=60")
    done(capsys, "replay", *high)
    why = checked(capsys, "why", "high.mcap")
    assert why["missed"] == 3
    assert all(reason["change"].startswith("passes.prominence=") for reason in why["reasons"])
    assert "prominence" in done(capsys, "why", "high.mcap").out
