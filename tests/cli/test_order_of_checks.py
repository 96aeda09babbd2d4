"""What is wrong in the command itself is said first: names and values, then files."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from command_runs import done, run

from groundtrace_codecs.errors import did_you_mean
from groundtrace_recordings import path_of

Capture = pytest.CaptureFixture[str]
#: Commands whose outputs are all there already, and that have a wrong name: what is said of it.
WRONG = {
    "replay walk.mcap --pipeline waist-stpes": "found neither; did you mean waist-steps?",
    "replay walk.mcap --set step.swing=0.3": "in 'step.swing=0.3'; did you mean steps?",
    "replay walk.mcap --set steps.swin=0.3": "found an unknown key; did you mean swing?",
    "replay walk.mcap --pipeline waist-steps --set steps.swing=-1": "expected float >= 0, found -1",
    "replay absent.mcap --pipeline waist-stpes": "found neither; did you mean waist-steps?",
    "sweep walk.results.mcap --grid steps.swin=0:1:3 --write kept.toml": "did you mean swing?",
    "sweep walk.mcap --pipeline waist-steps --grid stps.swing=0:1:3 --write kept.toml": (
        "in 'stps.swing=0:1:3'; did you mean steps?"
    ),
    "sweep walk.mcap --pipeline waist-stpes --grid a.b=0:1:3 --figure kept.svg": (
        "found neither; did you mean waist-steps?"
    ),
    "fleet walk.mcap --pipeline waist-stpes -o kept.parquet": "did you mean waist-steps?",
    "fleet walk.mcap --pipeline waist-steps --set steps.swin=1 -o kept.parquet": (
        "found an unknown key; did you mean swing?"
    ),
    "calibrate walk.mcap --pipeline room-footstep --geometry-out kept.toml": (
        "found neither; did you mean room-footsteps?"
    ),
    "merge walk.mcap other.mcap --pipeline walk=waist-stpes -o kept.mcap": (
        "found neither; did you mean waist-steps?"
    ),
    "annotate walk.mcap --serve --pipeline waist-stpes": "did you mean waist-steps?",
}
KEPT = ("walk.rrd", "kept.toml", "kept.svg", "kept.parquet", "kept.mcap")


@pytest.fixture(scope="module")
def replayed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make a short walk and its results, once."""
    from groundtrace.cli.main import main

    folder = tmp_path_factory.mktemp("replayed")
    walk, results = folder / "walk.mcap", folder / "walk.results.mcap"
    main(["cut", str(path_of("waist-walk.mcap")), "--to", "6", "-o", str(walk)])
    main(["replay", str(walk), "--no-viewer", "--out", str(results)])
    return folder


@pytest.fixture
def files(replayed: Path) -> None:
    """Lay walk.mcap, its results, another recording and all outputs into the current folder."""
    for name in ("walk.mcap", "walk.results.mcap"):
        shutil.copy(replayed / name, name)
    shutil.copy("walk.mcap", "other.mcap")
    for name in KEPT:
        Path(name).write_text("kept", "utf-8")


@pytest.mark.parametrize("command", WRONG, ids=str)
@pytest.mark.usefixtures("files")
def test_a_wrong_name_is_said_before_an_existing_file_with_the_nearest_right_one(
    command: str, capsys: Capture
) -> None:
    assert run(capsys, *command.split()).error.endswith(WRONG[command])
    assert [Path(name).read_text("utf-8") for name in KEPT] == ["kept"] * len(KEPT)


@pytest.mark.usefixtures("files")
def test_a_setting_of_the_pipeline_that_fits_is_checked_before_files_too(capsys: Capture) -> None:
    said = run(capsys, "replay", "walk.mcap", "--set", "steps.swing=0.3").error
    assert said.endswith("expected a new file, found an existing one; see --force")
    assert run(capsys, "replay", "walk.mcap", "--set", "steps.x=1").error.startswith("steps.x: ")


def test_a_name_like_none_gets_no_suggestion() -> None:
    assert did_you_mean("swin", ["swing", "share"]) == "; did you mean swing?"
    assert did_you_mean("zzz", ["swing", "share"]) == ""


@pytest.mark.parametrize(
    ("out", "timeline"),
    [("higher.mcap", "higher.rrd"), ("x.results.mcap", "x.rrd"), ("sub/y.mcap", "sub/y.rrd")],
)
@pytest.mark.usefixtures("files")
def test_the_timeline_is_named_as_the_results_are(out: str, timeline: str, capsys: Capture) -> None:
    Path("sub").mkdir()
    done(capsys, "replay", "walk.mcap", "--set", "steps.swing=0.3", "--out", out)
    assert Path(timeline).stat().st_size > 10_000
    assert Path("walk.rrd").read_text("utf-8") == "kept"


@pytest.mark.usefixtures("files")
def test_results_and_timeline_are_two_files(capsys: Capture) -> None:
    said = run(capsys, "replay", "walk.mcap", "--out", "a.rrd").error
    assert said == "a.rrd: expected another file than the results, found the same"
    assert not Path("a.rrd").exists()
