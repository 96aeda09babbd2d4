"""``groundtrace analyze attenuation``, as a user runs it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from command_runs import done, run

from groundtrace_recordings import path_of

if TYPE_CHECKING:
    from pathlib import Path

    import pytest

    Capture = pytest.CaptureFixture[str]


def test_the_waves_of_a_slab_fall_with_about_the_root_of_distance(
    tmp_path: Path, capsys: Capture
) -> None:
    room = tmp_path / "room.mcap"
    size = ("--side-m", "10x10", "--channels", 12, "--steps", 20, "--rate-hz", 4000)
    done(capsys, "simulate", "room", "-o", room, *size)
    law = done(capsys, "analyze", "attenuation", room, "--json").document
    assert law["impacts"] == 20
    assert law["samples"] == 240
    assert abs(law["exponent"] - 0.5) < 0.15
    assert -0.01 < law["loss_per_m"] < 0.08
    assert law["scatter"] < 0.2


def test_places_may_come_from_a_truth_table(tmp_path: Path, capsys: Capture) -> None:
    truth = tmp_path / "places.csv"
    truth.write_text("time_s,kind,x_m,y_m\n0.8,step,0.7,0.87\n", "utf-8")
    said = run(capsys, "analyze", "attenuation", path_of("room-walk.mcap"), "--truth", truth)
    assert "n " in said.out


def test_a_recording_without_places_is_refused_in_one_line(capsys: Capture) -> None:
    said = run(capsys, "analyze", "attenuation", path_of("waist-walk.mcap"))
    assert said.error.startswith("waist-walk.mcap: expected a geometry with sensors")
