"""The JSON of the commands: one document, as the schemas in docs/json say."""

from __future__ import annotations

import inspect
import json
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from command_runs import done, run
from jsonschema import Draft202012Validator, ValidationError
from jsonschema.validators import validator_for

from groundtrace.cli.main import application
from groundtrace_recordings import bundled, path_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from cyclopts import App

SCHEMAS = Path(__file__).parents[2] / "docs" / "json"
COMMANDS = (
    "analyze",
    "annotate",
    "compare",
    "copy",
    "demo",
    "doctor",
    "export",
    "figure",
    "fleet",
    "fleet-report",
    "import",
    "info",
    "merge",
    "pipelines",
    "plugins",
    "recordings",
    "replay",
    "score",
    "share",
    "simulate",
    "sweep",
    "why",
)
CSV_MAP = """
format = "csv"
time = {column = "t", unit = "s"}
[[stream]]
topic = "/imu/waist"
columns = [{column = "az", quantity = "acceleration", axis = "z", unit = "g"}]
"""


def schema(command: str) -> dict[str, Any]:
    loaded: dict[str, Any] = json.loads((SCHEMAS / f"{command}.schema.json").read_text("utf-8"))
    return loaded


def check(command: str, document: Any) -> None:
    Draft202012Validator(schema(command)).validate(document)


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def objects(node: Any) -> Iterator[dict[str, Any]]:
    """Yield every described thing of a schema."""
    if isinstance(node, dict):
        if "type" in node:
            yield node
        for key, child in node.items():
            if key != "enum":
                yield from objects(child)
    elif isinstance(node, list):
        for child in node:
            yield from objects(child)


@pytest.mark.parametrize("command", COMMANDS)
def test_a_schema_is_valid_closed_and_describes_every_property(command: str) -> None:
    loaded = schema(command)
    assert validator_for(loaded) is Draft202012Validator
    Draft202012Validator.check_schema(loaded)
    for node in objects(loaded):
        if "object" in node["type"]:
            assert node["additionalProperties"] is False or "type" in node["additionalProperties"]
            for name, inner in node.get("properties", {}).items():
                assert inner.get("description") or "$ref" in inner, name


@pytest.mark.parametrize("command", COMMANDS)
def test_a_schema_refuses_a_name_it_does_not_know(command: str) -> None:
    with pytest.raises(ValidationError, match="nobody_said_this"):
        check(command, {"nobody_said_this": 1})


def at(path: Sequence[str]) -> App:
    """Return a command by its words."""
    app = application()
    for name in path:
        app = app[name]
    return app


def commands(app: App) -> Iterator[tuple[str, ...]]:
    """Yield every command that has a function, group by group."""
    for name in app:
        if name.startswith("-"):
            continue
        if app[name].default_command:
            yield (name,)
        yield from ((name, *below) for below in commands(app[name]))


def test_every_command_has_json() -> None:
    every = list(commands(application()))
    assert len(every) > 25
    asked = {path: inspect.signature(at(path).default_command).parameters for path in every}
    assert [path for path, options in asked.items() if "json" not in options] == []


@pytest.mark.parametrize("name", sorted(bundled()))
def test_info_replay_and_score_of_a_bundled_recording_are_as_their_schemas_say(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copy(path_of(name), name)
    info = done(capsys, "info", name, "--json")
    check("info", info.document)
    assert info.err == ""
    replay = done(capsys, "replay", name, "--no-viewer", "--json").document
    check("replay", replay)
    assert replay["samples"] == sum(
        s["samples"] * len(s["channels"]) for s in info.document["streams"]
    )
    if not info.document["truth"]:
        assert "found none" in run(capsys, "score", replay["results"]).error
        return
    score = done(capsys, "score", replay["results"], "--json").document
    check("score", score)
    assert score.get("steps", {}).get("truth") == info.document["truth"].get("step")
    assert "picks" in score or "pick" not in info.document["truth"]


def test_the_remark_on_the_bundled_recording_goes_to_stderr(
    capsys: pytest.CaptureFixture[str],
) -> None:
    ran = done(capsys, "replay", "--no-viewer", "--to", 2, "--json")
    check("replay", ran.document)
    assert ran.document["recorded_s"] == pytest.approx(2.0)
    assert "bundled" in ran.err


def test_info_and_replay_of_a_torn_recording_are_as_their_schemas_say(
    capsys: pytest.CaptureFixture[str],
) -> None:
    whole = path_of("waist-walk.mcap").read_bytes()
    Path("torn.mcap").write_bytes(whole[: len(whole) * 2 // 3])
    info = done(capsys, "info", "torn.mcap", "--json").document
    check("info", info)
    assert info["damage"]
    replay = done(capsys, "replay", "torn.mcap", "--no-viewer", "--json", losses=True).document
    check("replay", replay)
    assert replay["damage"] >= 1


def test_scores_that_are_undefined_are_null(capsys: pytest.CaptureFixture[str]) -> None:
    replay = (
        "replay",
        path_of("waist-walk.mcap"),
        "--pipeline",
        "waist-peaks",
        "--no-viewer",
        "--out",
        "none.mcap",
    )
    done(capsys, *replay, "--set", "steps.height=1000")
    score = done(capsys, "score", "none.mcap", "--json").document
    check("score", score)
    assert score["steps"]["detected"] == 0
    assert score["steps"]["latency_ms"] is None


def test_calibrate_is_as_its_schema_says(capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copy(path_of("room-walk.mcap"), "room.mcap")
    found = done(capsys, "calibrate", "room.mcap", "--json").document
    check("calibrate", found)
    assert found["known_places"]
    assert found["geometry"] is None
    assert found["positions"]["rmse_after"] < found["positions"]["rmse_before"]


def test_import_is_as_its_schema_says(capsys: pytest.CaptureFixture[str]) -> None:
    rows = [f"{i / 50},{1 + (i % 25) / 50}" for i in range(200) if i != 100]
    Path("walk.csv").write_text("\n".join(["t,az", *rows]), "utf-8")
    Path("map.toml").write_text(CSV_MAP, "utf-8")
    Path("truth.csv").write_text("time_s,kind\n1.0,step\n2.0,step\n", "utf-8")
    arguments = ("walk.csv", "-o", "walk.mcap", "--map", "map.toml", "--truth", "truth.csv")
    imported = done(capsys, "import", *arguments, "--json").document
    check("import", imported)
    assert imported["samples"] == {"/imu/waist": 199}
    assert imported["labels"] == {"step": 2}
    info = done(capsys, "info", "walk.mcap", "--json").document
    check("info", info)
    assert info["truth"] == {"step": 2}


def test_plugins_and_pipelines_are_as_their_schemas_say(
    capsys: pytest.CaptureFixture[str],
) -> None:
    plain = done(capsys, "plugins", "--json").document
    check("plugins", plain)
    assert all(each["parameters"] is None for each in plain["plugins"])
    full = done(capsys, "plugins", "--parameters", "--json").document
    check("plugins", full)
    known = {each["name"]: each for each in full["plugins"]}
    assert (known["adaptive"]["use"], known["adaptive"]["gives"]) == ("detect", ["steps"])
    assert "score" in [each["name"] for each in known["adaptive"]["parameters"]]
    every = done(capsys, "pipelines", "--json").document
    check("pipelines", every)
    one = done(capsys, "pipelines", "waist-steps", "--json").document
    check("pipelines", one)
    assert one["pipelines"][0] in every["pipelines"]
    assert one["pipelines"][0]["stages"][0]["parameters"]["score"] == 0.4


def test_results_say_what_they_hold_and_their_score(capsys: pytest.CaptureFixture[str]) -> None:
    done(capsys, "replay", "waist-walk", "--no-viewer", "--to", 20)
    info = done(capsys, "info", "waist-walk.results.mcap", "--json").document
    check("info", info)
    found = info["results"]
    assert (found["recording"], found["pipeline"]) == ("waist-walk.mcap", "waist-steps")
    score = done(capsys, "score", "waist-walk.results.mcap", "--json").document["steps"]
    assert found["events"]["steps"] == score["detected"]
    assert found["score"]["steps.f1"] == score["f1"]
    said = done(capsys, "info", "waist-walk.results.mcap").out
    assert f"found: {score['detected']} steps" in said
    assert f"score: steps F1 {score['f1']:.3f}" in said
    quick = done(capsys, "info", "waist-walk.results.mcap", "--json", "--quick").document
    assert quick["results"]["score"] == {}
    assert done(capsys, "info", "waist-walk", "--json").document["results"] is None


@pytest.mark.sweep
def test_demo_figure_and_share_are_as_their_schemas_say(
    capsys: pytest.CaptureFixture[str],
) -> None:
    ran = done(capsys, "demo", "--no-viewer", "--json")
    check("demo", ran.document)
    assert "through waist-steps" in ran.err
    step = ran.document["missed"][0]["step"]
    assert ran.document["next"].endswith(f"--step {step}")
    results = ran.document["results"]
    drawn = done(capsys, "figure", results, "--step", step, "-o", "step.svg", "--json").document
    check("figure", drawn)
    assert (drawn["step"], drawn["cause"]) == (step, "threshold")
    for form, out in (("folder", "shared"), ("zip", "shared.zip"), ("html", "shared.html")):
        option = {"zip": ["--zip"], "html": ["--single-file"]}.get(form, [])
        shared = done(capsys, "share", results, "-o", out, *option, "--json").document
        check("share", shared)
        assert (shared["form"], shared["path"]) == (form, out)


def test_a_simulation_is_as_its_schema_says(capsys: pytest.CaptureFixture[str]) -> None:
    made = done(capsys, "simulate", "walk", "-o", "walk.mcap", "--duration-s", 20, "--json")
    check("simulate", made.document)
    assert made.document["truth"]["step"] > 5
