"""``groundtrace sweep``: what it prints is what a fresh replay and score give."""

from __future__ import annotations

import io
import json
import re
import shutil
from contextlib import chdir, redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import pytest
from command_runs import Ran, done, run
from jsonschema import Draft202012Validator, ValidationError

from groundtrace.cli.main import main
from groundtrace.pipeline.config import load_pipeline
from groundtrace_recordings import path_of

if TYPE_CHECKING:
    from collections.abc import Iterator

SCHEMA = Path(__file__).parents[2] / "docs" / "json" / "sweep.schema.json"
HEIGHT = ("--grid", "steps.height=0.4:2.8:13")
SHARP = ("--grid", "steps.window_s=0.1,0.2")
SWING = ("--grid", "steps.swing=1,3,5")


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.fixture(scope="module")
def replayed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the bundled walk and its results."""
    folder = tmp_path_factory.mktemp("replayed")
    shutil.copy(path_of("waist-walk.mcap"), folder / "walk.mcap")
    with chdir(folder), redirect_stdout(io.StringIO()):
        main(["replay", "walk.mcap", "--pipeline", "waist-peaks", "--no-viewer"])
    return folder


@pytest.fixture
def walk(replayed: Path) -> Path:
    """Results of the bundled walk, the recording beside them."""
    for name in ("walk.mcap", "walk.results.mcap"):
        shutil.copy(replayed / name, name)
    return Path("walk.results.mcap")


def swept(capsys: pytest.CaptureFixture[str], *arguments: object) -> Any:
    """Sweep with --json; the document is as its schema says."""
    document = done(capsys, "sweep", *arguments, "--json").document
    Draft202012Validator(json.loads(SCHEMA.read_text("utf-8"))).validate(document)
    return document


def scored(capsys: pytest.CaptureFixture[str], *replay: object) -> tuple[int, int, int]:
    """Replay, score, and return steps right, false and missed."""
    done(capsys, "replay", *replay, "--no-viewer", "--out", "again.mcap", "--force")
    steps = done(capsys, "score", "again.mcap", "--json").document["steps"]
    right = steps["matched"]
    return right, steps["detected"] - right, steps["truth"] - right


def counts(ranked: Any) -> tuple[int, int, int]:
    return ranked["tp"], ranked["fp"], ranked["fn"]


def sets(ranked: Any) -> list[str]:
    return [f"--set={name}={value}" for name, value in ranked["settings"].items()]


def described(node: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(node, dict):
        yield from node.get("properties", {}).items()
    if isinstance(node, dict | list):
        for child in node.values() if isinstance(node, dict) else node:
            yield from described(child)


def test_the_schema_is_closed_and_describes_every_property() -> None:
    loaded = json.loads(SCHEMA.read_text("utf-8"))
    Draft202012Validator.check_schema(loaded)
    for name, inner in described(loaded):
        assert inner.get("description") or "$ref" in inner, name
    with pytest.raises(ValidationError, match="nobody_said_this"):
        Draft202012Validator(loaded).validate({"nobody_said_this": 1})


@pytest.mark.sweep
def test_every_ranked_setting_gives_its_figures_in_a_fresh_replay(
    walk: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = swept(capsys, walk, *HEIGHT, *SWING, "--top", 4)
    assert found["rate"]["settings"] == 39
    assert found["rate"]["through"] == "gates"
    assert counts(found["now"]) == scored(capsys, "walk.mcap", "--pipeline", "waist-peaks")
    for ranked in found["top"]:
        assert counts(ranked) == scored(
            capsys, "walk.mcap", "--pipeline", "waist-peaks", *sets(ranked)
        )
    for point in found["front"]:
        _, false, missed = scored(capsys, "walk.mcap", "--pipeline", "waist-peaks", *sets(point))
        assert (missed, false) == (point["missed"], point["false"])
    assert found["left_out"] is None
    assert found["notes"] == []


def test_the_written_pipeline_loads_and_gives_the_printed_figures(
    walk: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    grid = ("--grid", "steps.height=1:3:21", "--grid", "steps.swing=2:6:5")
    found = swept(capsys, walk, *grid, "--write", "best.toml")
    assert (
        load_pipeline("best.toml").stage[0].parameters.items()
        >= {
            name.removeprefix("steps."): value for name, value in found["best"]["settings"].items()
        }.items()
    )
    assert counts(found["best"]) == scored(capsys, "walk.mcap", "--pipeline", "best.toml")


def test_the_signal_path_is_measured_again_beside_gates(
    walk: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    grid = ("--grid", "steps.cutoff_hz=1.5,3,5", "--grid", "steps.height=1,2")
    ran = done(capsys, "sweep", walk, *grid, "--jobs", 2, "--top", 3, "--json")
    assert "2 measurements" in ran.err
    found = ran.document
    assert found["rate"]["measurements"] == 2
    assert [p["remeasured"] for p in found["parameters"]] == [True, False]
    for ranked in found["top"]:
        assert counts(ranked) == scored(
            capsys, "walk.mcap", "--pipeline", "waist-peaks", *sets(ranked)
        )


def test_settings_that_a_replay_refuses_are_left_out_and_counted(
    capsys: pytest.CaptureFixture[str],
) -> None:
    done(capsys, "replay", path_of("room-walk.mcap"), "--no-viewer", "--out", "room.mcap")
    grid = ("--grid", "steps.window_s=0.03:0.07:5", "--grid", "picks.ratio=5,6")
    found = swept(capsys, "room.mcap", *grid)
    assert found["rate"]["settings"] == 6
    assert all(r["settings"]["steps.window_s"] >= 0.05 for r in [found["best"], *found["top"]])
    (note,) = [n for n in found["notes"] if "left out" in n]
    assert note.startswith(
        "4 of 10 settings left out, which a replay refuses: times-amplitudes.after"
    )
    assert swept(capsys, "room.mcap", *grid, "--random", 20)["rate"]["settings"] < 20
    error = run(capsys, "sweep", "room.mcap", "--grid", "steps.window_s=0.005,0.02").error
    assert error == "arrivals.after_s: expected at most the 0.005 s that steps waits, found 0.03"


def test_the_recording_is_looked_for_beside_the_results_and_where_it_is_said(
    walk: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    grid = ("--grid", "steps.cutoff_hz=2,4")
    Path("elsewhere").mkdir()
    Path("walk.mcap").rename("elsewhere/moved.mcap")
    shutil.copy(path_of("room-walk.mcap"), "walk.mcap")
    error = run(capsys, "sweep", walk, *grid).error
    assert error.startswith("walk.mcap: expected the recording beside its results")
    found = swept(capsys, walk, *grid, "--recording", "elsewhere/moved.mcap", "--jobs", 1)
    assert found["rate"]["measurements"] == 2


def test_a_recording_is_swept_with_a_pipeline_as_its_results_are(
    walk: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    error = run(capsys, "sweep", "walk.mcap", *HEIGHT).error
    assert error.startswith("walk.mcap: expected --pipeline NAME")
    fresh = swept(capsys, "walk.mcap", *HEIGHT, "--pipeline", "waist-peaks")
    stored = swept(capsys, walk, *HEIGHT)
    for document in (fresh, stored):
        del document["rate"]
    assert fresh == stored


def test_a_chain_with_an_associator_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copy(path_of("room-walk.mcap"), "room.mcap")
    done(capsys, "replay", "room.mcap", "--no-viewer")
    grid = ("--grid", "picks.ratio=5:15:6", "--grid", "steps.min_channels=2:9:8")
    found = swept(capsys, "room.results.mcap", *grid, "--top", 2)
    assert found["rate"]["through"] == "associator"
    for ranked in found["top"]:
        assert counts(ranked) == scored(capsys, "room.mcap", *sets(ranked))


def test_of_several_recordings_each_is_left_out(
    walk: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for seed in (3, 4):
        walked = ("--seed", seed, "--duration-s", 20)
        done(capsys, "simulate", "walk", "-o", f"w{seed}.mcap", *walked)
        done(capsys, "replay", f"w{seed}.mcap", "--pipeline", "waist-peaks", "--no-viewer")
    results = (walk, "w3.results.mcap", "w4.results.mcap")
    found = swept(capsys, *results, *HEIGHT)
    assert found["recordings"] == ["walk.mcap", "w3.mcap", "w4.mcap"]
    assert [x["recording"] for x in found["left_out"]["recordings"]] == found["recordings"]
    for left in found["left_out"]["recordings"]:
        assert counts(left) == scored(
            capsys, left["recording"], "--pipeline", "waist-peaks", *sets(left)
        )
    alone = [counts(swept(capsys, result, *HEIGHT)["now"]) for result in results]
    assert counts(found["now"]) == tuple(map(sum, zip(*alone, strict=True)))
    done(capsys, "replay", "w3.mcap", "--no-viewer", "--force", "--set", "steps.swing=2")
    error = run(capsys, "sweep", *results, *HEIGHT).error
    assert error.startswith("w3.mcap: pipeline: expected that of walk.mcap")


def test_random_settings_are_the_same_for_the_same_seed(
    walk: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    random = (*HEIGHT, "--grid", "steps.swing=1:6:2", "--random", 50, "--seed", 7)
    first, again = (swept(capsys, walk, *random) for _ in range(2))
    for document in (first, again):
        del document["rate"]
    assert first == again
    assert counts(first["best"]) == scored(
        capsys, "walk.mcap", "--pipeline", "waist-peaks", *sets(first["best"])
    )


def test_the_table_prints_settings_that_replay_takes(
    walk: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ran: Ran = done(capsys, "sweep", walk, "--grid", "steps.height=1:3:7", *SWING, "--top", 2)
    lines = ran.out.splitlines()
    assert lines[0] == "walk.mcap: 74 true steps, 21 settings"
    replay = next(line for line in lines if line.startswith("replay with "))
    right, false, missed = scored(
        capsys, "walk.mcap", "--pipeline", "waist-peaks", *replay.split()[2:]
    )
    assert re.match(rf"1 .* {right} +{false} +{missed} ", lines[2])
    assert lines[-1].endswith("recorded seconds per second")


@pytest.mark.parametrize("grid", [HEIGHT, (*HEIGHT, *SWING), (*HEIGHT, *SWING, "--random", "80")])
def test_the_figure_is_an_svg_that_needs_nothing_else(
    walk: Path, grid: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    done(capsys, "sweep", walk, *grid, "--figure", "sweep.svg")
    text = Path("sweep.svg").read_text("utf-8")
    root = ElementTree.fromstring(text)
    assert root.tag == "{http://www.w3.org/2000/svg}svg"
    assert "nan" not in re.findall(r'="([^"]*)"', text)
    assert "steps.height [m/s2]" in text
    assert not re.search(r'href="[^#]|url\(|<script', text)
    done(capsys, "sweep", walk, *grid, "--figure", "sweep.svg")  # of the same recording
    assert Path("sweep.svg").read_text("utf-8") == text


def test_truth_may_come_from_a_file(walk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("truth.csv").write_text("time_s,kind\n5.0,step\n6.0,step\n", "utf-8")
    found = swept(capsys, walk, *HEIGHT, "--truth", "truth.csv", "--tolerance", 0.2)
    assert found["truth"] == 2
    assert found["tolerance_s"] == 0.2
    error = run(capsys, "sweep", walk, walk, *HEIGHT, "--truth", "truth.csv").error
    assert error == "--truth: expected one recording, found 2"


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ((), "--grid: expected at least one parameter to sweep, found none"),
        (("--grid", "steps.height=3:1:4"), "--grid: expected FROM:TO:COUNT with FROM < TO"),
        (("--grid", "steps.cutoff_hz=0:1:4"), "steps.cutoff_hz: expected float > 0"),
        ((*SHARP, "--pipeline", "room-footsteps"), "walk.mcap: pipeline: expected that of --pi"),
        ((*HEIGHT, "--pipeline", "room-footsteps"), "steps.height: expected one of window_s, "),
        ((*HEIGHT, "--truth", "none.csv"), "none.csv: expected a truth file"),
        ((*HEIGHT, "--write", "walk.results.mcap", "--force"), "walk.results.mcap: expected a new"),
    ],
)
def test_what_cannot_be_swept_is_said_in_one_line(
    walk: Path, arguments: tuple[str, ...], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(capsys, "sweep", walk, *arguments).error.startswith(says)


def test_without_inputs_or_truth_there_is_nothing_to_sweep(
    walk: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(capsys, "sweep", *HEIGHT).error == (
        "sweep: expected results or recordings, found none"
    )
    Path("none.csv").write_text("time_s,kind\n", "utf-8")
    error = run(capsys, "sweep", walk, *HEIGHT, "--truth", "none.csv").error
    assert error.startswith("walk.mcap: expected true steps")
