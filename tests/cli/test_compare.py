"""``groundtrace compare``: its text, its JSON, its file, and what it refuses."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from command_runs import check_schema, done, run

from groundtrace_recordings import path_of

Capture = pytest.CaptureFixture[str]
WALK = path_of("waist-walk.mcap")


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def pair(walks: tuple[Path, Path], tmp_path: Path) -> tuple[Path, Path]:
    """Results of the bundled walk with two settings, in the present folder."""
    for path in walks:
        shutil.copy(path, tmp_path / path.name)
    return Path("a.mcap"), Path("b.mcap")


@pytest.fixture(scope="module")
def walks(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    from groundtrace.cli.main import main

    folder = tmp_path_factory.mktemp("walks")
    for name, height in (("a.mcap", 2.0), ("b.mcap", 0.4)):
        out = ("--out", str(folder / name), "--set", f"steps.height={height}")
        main(["replay", str(WALK), "--pipeline", "waist-peaks", "--no-viewer", *out])
    return folder / "a.mcap", folder / "b.mcap"


def test_the_text_says_what_differs_and_by_which_gate(
    pair: tuple[Path, Path], capsys: Capture
) -> None:
    lines = done(capsys, "compare", *pair).out.splitlines()
    assert lines[:4] == [
        "waist-walk.mcap: A a.mcap, 53 right, 21 missed, 0 false; "
        "B b.mcap, 74 right, 0 missed, 0 false",
        "  steps.height: A 2.0, B 0.4",
        "53 both right, 21 only B right",
        "McNemar's exact test: p = 9.5e-07 (more than chance explains)",
    ]
    rows = lines[6:]
    assert len(rows) == 21
    assert all("only B right" in row and "height" in row and "< 2 m/s2" in row for row in rows)


def test_a_result_equals_itself(pair: tuple[Path, Path], capsys: Capture) -> None:
    found = done(capsys, "compare", pair[0], pair[0], "--json").document
    check_schema("compare", found)
    assert found["verdicts"] == {"both right": 53, "both missed": 21}
    assert (found["parameters"], found["p_value"]) == ([], None)


def test_one_more_step_is_no_more_than_chance_explains(
    pair: tuple[Path, Path], capsys: Capture
) -> None:
    done(
        capsys,
        "replay",
        WALK,
        "--pipeline",
        "waist-peaks",
        "--no-viewer",
        "--out",
        "c.mcap",
        "--set",
        "steps.height=0.6",
    )
    text = done(capsys, "compare", "c.mcap", pair[1]).out
    assert "1 only B right" in text
    assert "p = 1 (no more than chance explains)" in text


def test_the_json_is_as_its_schema_says_with_and_without_truth(
    pair: tuple[Path, Path], capsys: Capture
) -> None:
    found = done(capsys, "compare", *pair, "--json")
    check_schema("compare", found.document)
    assert found.err == ""
    assert found.document["parameters"] == [
        {"stage": "steps", "parameter": "height", "a": 2.0, "b": 0.4}
    ]
    differing = [d for d in found.document["decisions"] if d["obstacle"]]
    assert len(differing) == 21
    assert {d["obstacle"]["side"] for d in differing} == {"A"}
    Path("none.csv").write_text("time_s,kind\n", "utf-8")
    alone = done(capsys, "compare", *pair, "--truth", "none.csv", "--json").document
    check_schema("compare", alone)
    assert set(alone["verdicts"]) == {"both", "only B"}
    assert (alone["a"]["counts"], alone["p_value"]) == (None, None)


def test_a_real_recording_is_compared(data: Path, capsys: Capture) -> None:
    source = data / "mobgap" / "HA" / "001" / "data.mat"
    done(capsys, "import", source, "-o", "ha.mcap", "--map", "mobgap-test11")
    done(capsys, "replay", "ha.mcap", "--pipeline", "waist-peaks", "--no-viewer", "--out", "a.mcap")
    lower = ("--set", "steps.height=0.3", "--set", "steps.swing=0.6")
    done(
        capsys,
        "replay",
        "ha.mcap",
        "--pipeline",
        "waist-peaks",
        "--no-viewer",
        "--out",
        "b.mcap",
        *lower,
    )
    found = done(capsys, "compare", "a.mcap", "b.mcap", "--json").document
    check_schema("compare", found)
    for side, name in (("a", "A"), ("b", "B")):
        own = done(capsys, "score", f"{side}.mcap", "--json").document["steps"]
        verdicts = found["verdicts"]
        right = verdicts.get("both right", 0) + verdicts.get(f"only {name} right", 0)
        assert (found[side]["counts"]["tp"], right) == (own["matched"], own["matched"])
        assert found[side]["counts"]["fp"] == own["detected"] - own["matched"]
    assert {(p["stage"], p["parameter"]) for p in found["parameters"]} == {
        ("steps", "height"),
        ("steps", "swing"),
    }
    assert found["p_value"] > 0.05


def test_a_file_of_both_is_written(pair: tuple[Path, Path], capsys: Capture) -> None:
    ran = done(capsys, "compare", *pair, "--rrd", "both.rrd")
    assert "timeline: both.rrd" in ran.err
    assert Path("both.rrd").stat().st_size > 5_000


def test_what_cannot_be_compared_is_refused_in_one_line(
    pair: tuple[Path, Path], capsys: Capture
) -> None:
    done(capsys, "replay", "--no-viewer", "--to", 1, "--out", "room.mcap")
    said = run(capsys, "compare", pair[0], "room.mcap").error
    assert said.startswith("a.mcap and room.mcap: expected results of one recording, found ")
    assert "waist-walk.mcap (" in said
    assert "room-walk.mcap (" in said
    done(
        capsys,
        "replay",
        WALK,
        "--pipeline",
        "waist-peaks",
        "--no-viewer",
        "--to",
        20,
        "--out",
        "part.mcap",
    )
    assert "same part of waist-walk.mcap" in run(capsys, "compare", pair[0], "part.mcap").error
    assert run(capsys, "compare", pair[0], "absent.mcap").error == (
        "absent.mcap: expected a results file, found no such file"
    )
    assert "expected results, found a recording" in run(capsys, "compare", pair[0], WALK).error
    said = run(capsys, "compare", *pair, "--rrd", pair[1], "--force").error
    assert said == "b.mcap: expected a new file, found the one that is read"
    assert run(capsys, "compare", pair[0]).error.startswith(
        "a.previous.mcap: expected the results "
    )
    assert run(capsys, "compare").code == 2
