"""The pipeline of worn sensors, with its defaults, on phones and wrists that others recorded."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from command_runs import done

if TYPE_CHECKING:
    from pathlib import Path

WRIST = "rieck-stepcounter/l2-25hz-bw4"


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def scored(capsys: pytest.CaptureFixture[str], source: Path, map_: str) -> Any:
    """Import, replay by name, score at 0.25 s."""
    done(capsys, "import", source, "-o", "rec.mcap", "--map", map_)
    done(
        capsys, "replay", "rec.mcap", "--pipeline", "waist-steps", "--no-viewer", "--out", "r.mcap"
    )
    return done(capsys, "score", "r.mcap", "--tolerance", 0.25, "--json").document["steps"]


@pytest.mark.parametrize("where", ["backpocket", "hand"])
def test_a_phones_steps_are_counted_wherever_it_is_carried(
    where: str, data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = next((data / "oxford-step" / "validation").glob(f"user1_{where}_*.csv"))
    steps = scored(capsys, source, "oxford-step-validation")
    assert abs(steps["count_error_signed"]) <= 0.015 * steps["count_truth"]
    assert steps["f1"] >= 0.97
    assert steps["f1"] > steps["chance_f1_metronome"] + 0.1


@pytest.mark.parametrize(
    ("name", "least", "most"),
    [("normal-walking1", 90, 108), ("fast-walking2", 144, 176), ("pc-working1", 0, 5),
     ("shoe-laces1", 0, 20), ("dressing1", 0, 25)],
)  # fmt: skip
def test_a_wrist_counts_walking_and_little_else(
    name: str, least: int, most: int, data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    steps = scored(capsys, data / WRIST / f"{name}.csv", "rieck-stepcounter")
    assert least <= steps["count_truth"] + steps["count_error_signed"] <= most
