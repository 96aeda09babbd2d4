"""The command line: help, usage, lists, and known errors in one line."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from command_runs import done, run

from groundtrace.cli.main import COMMANDS, SIMULATIONS
from groundtrace.pipeline.config import load_pipeline, named_pipelines
from groundtrace.pipeline.parameters import describe
from groundtrace.pipeline.plugins import GROUPS, load, plugins
from groundtrace.pipeline.results import read_results
from groundtrace_codecs import Channel, SignalBlock, Stream, write_recording
from groundtrace_recordings import path_of

if TYPE_CHECKING:
    from collections.abc import Sequence

Capture = pytest.CaptureFixture[str]
ROOT = Path(__file__).parents[2]
WALK = path_of("waist-walk.mcap")
HEAVY = ("numpy", "scipy", "rerun", "obspy", "mcap", "numba", "google.protobuf", "msgspec")
HELP = [(name,) for name in (*COMMANDS, "simulate")] + [("simulate", name) for name in SIMULATIONS]


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def python(code: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", code, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def in_a_process(*arguments: object) -> subprocess.CompletedProcess[str]:
    return python("from groundtrace.cli.main import main; main()", *arguments)


def pressure(path: Path) -> Path:
    """Write a recording that tells no pipeline and has no truth."""
    stream = Stream("/baro", (Channel("p", "pressure", "Pa"),), 10.0)
    block = SignalBlock(stream, 0, 0, np.full((50, 1), 101325.0))
    write_recording(path, [(stream, "f32le", [block])])
    return path


def test_a_replay_in_a_process_ends_with_0_and_results_without_its_folders() -> None:
    out = ("--out", Path.cwd() / "r.mcap")
    good = in_a_process("replay", WALK, "--no-viewer", "--to", 3, *out)
    assert (good.returncode, good.stderr) == (0, "")
    assert "waist-steps" in good.stdout
    told = read_results(Path("r.mcap")).provenance
    options = ("--no-viewer", "--to", "3", "--out", "r.mcap")
    assert told.arguments == ("replay", "waist-walk.mcap", *options)


def test_exit_codes_are_1_known_error_2_wrong_usage() -> None:
    known = in_a_process("info", "nowhere.mcap")
    assert (known.returncode, known.stdout) == (1, "")
    found = "groundtrace: nowhere.mcap: expected a recording, found no such file\n"
    assert known.stderr == found
    wrong = in_a_process("replay", "--speed", "3")
    assert (wrong.returncode, wrong.stdout) == (2, "")
    assert "--speed" in wrong.stderr


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import sys\nfrom groundtrace.cli.main import main\nmain(['--help'])\n"
        f"print([m for m in {HEAVY} if m in sys.modules])"
    )
    ran = python(code)
    assert ran.stdout.splitlines()[-1] == "[]", ran.stderr
    for name in (*COMMANDS, "simulate"):
        assert f" {name} " in ran.stdout


@pytest.mark.parametrize("command", HELP, ids=" ".join)
def test_help_of_a_command_has_an_example(command: tuple[str, ...], capsys: Capture) -> None:
    ran = done(capsys, *command, "--help")
    assert f"Example: groundtrace {' '.join(command)}" in " ".join(ran.out.split())


def test_a_reader_that_has_seen_enough_ends_the_command_quietly() -> None:
    code = "from groundtrace.cli.main import main; main(['plugins', '--parameters'])"
    command = [sys.executable, "-c", code]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as ran:
        assert ran.stdout is not None
        assert ran.stderr is not None
        ran.stdout.close()
        said = ran.stderr.read()
    assert (ran.returncode, said) == (1, b"")


@pytest.mark.parametrize(
    "arguments",
    [
        ("nothing",),
        ("simulate", "sea"),
        ("replay", "--rate", "fast"),
        ("replay", "--rate", "inf"),
        ("replay", "--rate", "-1"),
        ("replay", "--from", "nan"),
        ("info",),
        ("info", "a.mcap", "b.mcap"),
        ("score", "r.mcap", "--tolerance", "0"),
        ("score", "r.mcap", "--tolerance", "inf"),
        ("import", "a.csv"),
    ],
    ids=" ".join,
)
def test_wrong_usage_exits_with_2(arguments: Sequence[str], capsys: Capture) -> None:
    ran = run(capsys, *arguments)
    assert (ran.code, ran.out) == (2, "")
    assert ran.err


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("step.height=1", "--set: expected a stage of steps, found 'step' in 'step.height=1'"),
        ("steps.hight=1", "steps.hight: expected one of cutoff_hz,"),
        ("steps.height=-1", "steps.height: expected float >= 0, found -1"),
        ("steps.height=high", "steps.height: expected float >= 0, found 'high'"),
        ("height=1", "--set: expected stage.param=value, found 'height=1'"),
        ("steps.height", "--set: expected stage.param=value, found 'steps.height'"),
    ],
)
def test_a_setting_that_cannot_be_is_one_line(setting: str, said: str, capsys: Capture) -> None:
    ran = run(capsys, "replay", WALK, "--pipeline", "waist-peaks", "--no-viewer", "--set", setting)
    assert ran.error.startswith(said)
    assert list(Path().iterdir()) == []


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("replay WALK --pipeline nope", "nope: expected a file or one of "),
        ("pipelines nope", "nope: expected a file or one of "),
        ("replay nope.mcap", "nope.mcap: expected a recording, found no such file"),
        ("replay .", ".: expected a recording, found no such file"),
        ("replay text.mcap", "text.mcap: start of file: expected the MCAP magic"),
        ("info text.mcap", "text.mcap: start of file: expected the MCAP magic"),
        ("score text.mcap", "text.mcap: start of file: expected the MCAP magic"),
        ("info empty.mcap", "empty.mcap: start of file: expected the MCAP magic"),
        ("score WALK", "waist-walk.mcap: expected results, found a recording; replay it first: "),
        ("score nope.mcap", "nope.mcap: expected a results file, found no such file"),
        ("replay WALK --pipeline text.mcap", "text.mcap: expected TOML, found:"),
        (
            "replay WALK --no-viewer --from 60.5",
            "--from: expected at most the 59.99 s",
        ),
        ("replay WALK --no-viewer --from 5 --to 5", "--to: expected more than --from 5"),
        ("replay WALK --out text.mcap/r.mcap", "text.mcap/r.mcap: expected a folder to write in"),
        ("replay WALK --rrd text.mcap/r.rrd", "text.mcap/r.rrd: expected a folder to write in"),
        ("replay WALK --out . --force", ".: expected a file to write, found a folder"),
        ("import nope.csv -o n.mcap", "nope.csv: expected a file or folder"),
        ("import -o n.mcap", "import: expected at least one file, found none"),
        ("import text.mcap -o n.mcap", "text.mcap: expected a format of audio, csv,"),
        ("import text.mcap -o n.mcap --format x", "--format: expected one of audio, csv,"),
        ("simulate room -o r.mcap --steps 0", "simulate room: steps: expected 1 or more"),
        ("simulate room -o r.mcap --seed -1", "simulate room: seed: expected 0 or more"),
        ("simulate room -o r.mcap --rate-hz inf", "simulate room: rate_hz: expected 1000 to"),
        ("simulate room -o r.mcap --duration-s inf", "simulate room: duration_s: expected > 0"),
        ("simulate walk -o w.mcap --duration-s inf", "simulate walk: duration_s: expected > 0"),
        ("simulate walk -o w.mcap --seed -1", "simulate walk: seed: expected 0 or more"),
    ],
)
def test_a_known_error_is_one_line(line: str, said: str, capsys: Capture) -> None:
    Path("text.mcap").write_text("time,value\n", "utf-8")
    Path("empty.mcap").touch()
    before = sorted(Path().iterdir())
    arguments = [WALK if word == "WALK" else word for word in line.split()]
    assert run(capsys, *arguments).error.startswith(said)
    assert sorted(Path().iterdir()) == before


def test_a_score_without_truth_is_one_line(capsys: Capture) -> None:
    pressure(Path("baro.mcap"))
    done(capsys, "replay", "baro.mcap", "--pipeline", "signals", "--no-viewer")
    said = run(capsys, "score", "baro.results.mcap").error
    assert said.startswith("baro.results.mcap: expected truth to score against")
    missing = run(capsys, "score", "baro.results.mcap", "--truth", "none.csv").error
    assert missing == "none.csv: expected a truth file, found no such file"


@pytest.mark.parametrize(
    "arguments",
    [
        ("replay", WALK, "--no-viewer", "--to", 3, "--out", "kept"),
        ("replay", WALK, "--to", 3, "--rrd", "kept"),
        ("simulate", "walk", "--duration-s", 5, "-o", "kept"),
        ("import", "table.csv", "--map", "map.toml", "-o", "kept"),
    ],
    ids=lambda value: f"{value[0]} {value[-2]}",
)
def test_an_existing_output_is_refused_without_force(
    arguments: Sequence[object], capsys: Capture
) -> None:
    kept = Path("kept")
    kept.write_text("mine", "utf-8")
    Path("table.csv").write_text("t,a\n0,1\n0.1,2\n0.2,1\n", "utf-8")
    columns = '[{column = "a", quantity = "acceleration", axis = "z", unit = "g"}]'
    stream = f'[[stream]]\ntopic = "/imu"\ncolumns = {columns}\n'
    text = f'format = "csv"\ntime = {{column = "t", unit = "s"}}\n{stream}'
    Path("map.toml").write_text(text, "utf-8")
    found = "kept: expected a new file, found an existing one; see --force"
    assert run(capsys, *arguments).error == found
    assert kept.read_text("utf-8") == "mine"
    done(capsys, *arguments, "--force")
    assert kept.stat().st_size > 100


@pytest.mark.parametrize("option", ["--out", "--rrd"])
def test_force_never_overwrites_the_recording_itself(option: str, capsys: Capture) -> None:
    recording = pressure(Path("baro.mcap"))
    before = recording.read_bytes()
    said = run(
        capsys,
        *("replay", recording, "--pipeline", "signals"),
        *(option, recording.resolve(), "--force"),
    ).error
    assert said.endswith("baro.mcap: expected a new file, found the one that is read")
    assert recording.read_bytes() == before


def test_plugins_lists_every_registered_plugin_of_every_group(capsys: Capture) -> None:
    rows = [line.split() for line in done(capsys, "plugins").out.splitlines()[1:]]
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    names = [name for group in GROUPS for name in declared["entry-points"][f"groundtrace.{group}"]]
    assert sorted(row[1] for row in rows if "groundtrace" in row) == sorted(names)
    uses = list(dict.fromkeys(row[0] for row in rows))
    assert uses == ["detect", "locate", "track", "import", "export", "show"]


def test_plugins_lists_every_parameter_with_its_unit(capsys: Capture) -> None:
    text = done(capsys, "plugins", "--parameters").out
    for plugin in plugins("stages"):
        for info in describe(load("stages", plugin.name).Parameters):
            assert any(
                line.startswith(info.name) and info.unit in line and line.endswith(info.doc)
                for line in text.splitlines()
            ), (plugin.name, info.name)


def test_pipelines_lists_those_that_ship(capsys: Capture) -> None:
    text = done(capsys, "pipelines").out
    listed = [line.split()[0] for line in text.splitlines()[1:]]
    assert listed == list(named_pipelines())
    for name in listed:
        assert load_pipeline(name).description in text
