"""A detector of another distribution: built, installed, listed, checked and used by name."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from command_runs import run

from groundtrace.evaluation.picks import score_picks
from groundtrace.pipeline.conformance import check_stage
from groundtrace.pipeline.parameters import describe
from groundtrace.pipeline.results import read_results
from groundtrace.pipeline.source import Source
from groundtrace_codecs import Pick, Recording
from groundtrace_codecs.signals import NS_PER_S
from groundtrace_recordings import path_of

EXAMPLE = Path(__file__).parent / "plugin_example"
MODULE = EXAMPLE / "src" / "groundtrace_threshold" / "__init__.py"
CONTRIBUTING = Path(__file__).parents[1] / "CONTRIBUTING.md"
PIPELINE = """\
name = "amplitude"
description = "Arrivals by amplitude."

[[stage]]
name = "picks"
use = "threshold"
[stage.parameters]
level = 3e-5

[[stage]]
name = "steps"
use = "coincidence"
"""
CHECK = """\
from groundtrace.pipeline.conformance import check_stage
from groundtrace.pipeline.plugins import load
from groundtrace.pipeline.source import Source
from groundtrace_codecs import Recording
from groundtrace_recordings import path_of

with Recording.open(path_of("room-walk.mcap")) as recording:
    items = list(Source(recording, stop_ns=recording.start_ns + 3_000_000_000))
found = check_stage(load("stages", "threshold"), items)
print(len(found.times), int(found.accepted.sum()))
"""


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The example project, built from a copy and installed into a folder of its own."""
    folder = tmp_path_factory.mktemp("plugin")
    shutil.copytree(EXAMPLE, folder / "project")
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-index", "--no-deps"]
    offline = ["--no-build-isolation", "--disable-pip-version-check"]
    target = folder / "site"
    command = [*pip, *offline, "--target", str(target), str(folder / "project")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return target


def python(site: Path, cwd: Path, *arguments: str) -> str:
    """Run Python with the plugin on its path; return what it prints."""
    path = os.pathsep.join(filter(None, [str(site), os.environ.get("PYTHONPATH")]))
    done = subprocess.run(
        [sys.executable, *arguments],
        cwd=cwd,
        env=os.environ | {"PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def groundtrace(site: Path, cwd: Path, *arguments: str) -> str:
    return python(site, cwd, "-c", "from groundtrace.cli.main import main; main()", *arguments)


def test_an_installed_plugin_is_listed_with_its_distribution(
    installed: Path, tmp_path: Path
) -> None:
    listed = groundtrace(installed, tmp_path, "plugins", "--parameters")
    rows = [line.split() for line in listed.splitlines()]
    assert ["detect", "threshold", "picks", "groundtrace-threshold", "0.1.0"] in rows
    assert ["detect", "toa-cv", "picks", "groundtrace", rows[1][4]] in rows
    assert "threshold: An arrival is a peak of the amplitude" in listed


def test_an_installed_plugin_passes_the_conformance_test(installed: Path, tmp_path: Path) -> None:
    candidates, accepted = map(int, python(installed, tmp_path, "-c", CHECK).split())
    assert candidates > accepted > 9


def test_a_pipeline_that_uses_an_installed_plugin_replays(installed: Path, tmp_path: Path) -> None:
    (tmp_path / "amplitude.toml").write_text(PIPELINE, "utf-8")
    options = ("--pipeline", "amplitude.toml", "--no-viewer", "--out", "r.mcap", "--json")
    told = json.loads(groundtrace(installed, tmp_path, "replay", *options))
    assert (told["pipeline"], told["events"]["steps"]) == ("amplitude", 20)
    results = read_results(tmp_path / "r.mcap")
    assert "level = 3e-05  # m/s; decide" in results.provenance.pipeline
    picks = [e for e in results.events if isinstance(e, Pick)]
    score = score_picks(results.labels, picks)
    assert score is not None
    assert score.all.answered_fraction == 1.0
    assert abs(score.all.median_ms or 99) < 2


def test_without_the_plugin_its_name_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "amplitude.toml").write_text(PIPELINE, "utf-8")
    pipeline = ("--pipeline", tmp_path / "amplitude.toml", "--no-viewer")
    said = run(capsys, "replay", path_of("room-walk.mcap"), *pipeline).error
    assert said.startswith("use: expected one of adaptive, ")
    assert said.endswith("found 'threshold'")


def test_the_example_conforms_in_this_process_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(MODULE.parents[1]))
    from groundtrace_threshold import ThresholdPicker

    with Recording.open(path_of("room-walk.mcap")) as recording:
        items = list(Source(recording, stop_ns=recording.start_ns + 2 * NS_PER_S))
    found = check_stage(ThresholdPicker, items)
    assert found.trace_times.size == 0
    assert [info.unit for info in describe(ThresholdPicker.Parameters)] == ["m/s", "m/s", "s"]


def test_the_example_in_contributing_is_the_one_that_is_tested() -> None:
    text = CONTRIBUTING.read_text("utf-8")
    for path in (MODULE, EXAMPLE / "pyproject.toml"):
        assert path.read_text("utf-8").strip() in text, f"{path.name} is not as shown there"


def test_the_example_is_as_short_as_promised() -> None:
    text = MODULE.read_text("utf-8")
    code = text[text.index("@dataclass") :]
    assert len([line for line in code.splitlines() if line.strip()]) <= 30
