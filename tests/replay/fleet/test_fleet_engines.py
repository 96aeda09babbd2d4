"""Engines: every task once, a killed worker costs only its task, one table whatever computes it."""

from __future__ import annotations

import time
from importlib.util import find_spec
from typing import TYPE_CHECKING

import pytest
from command_runs import run
from fleet_runs import Here, overdue, ran_fleet, twice, use, walks

from groundtrace.fleet.engines import LocalEngine

if TYPE_CHECKING:
    from pathlib import Path

Capture = pytest.CaptureFixture[str]


def test_a_killed_worker_is_replaced_and_its_task_tried_once_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    marker = tmp_path / "killed"
    monkeypatch.setenv("FLEET_TEST_MARKER", str(marker))
    tasks = [1, 7, 13, 4, 5]
    answers = dict(LocalEngine(2).run(twice, tasks))
    assert answers == {0: 2, 1: 14, 2: None, 3: 8, 4: 10}
    kills = {p.name: len(p.read_text("utf-8").split()) for p in tmp_path.iterdir()}
    assert kills == {"killed-7": 1, "killed-13": 2}


def test_closing_the_answers_ends_the_workers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from multiprocessing import active_children

    monkeypatch.setenv("FLEET_TEST_MARKER", str(tmp_path / "killed"))
    answers = LocalEngine(1).run(twice, [1, 2, 3])
    assert next(answers) == (0, 2)
    assert active_children()
    answers.close()  # type: ignore[attr-defined]
    assert not active_children()


def test_processes_and_a_dask_cluster_give_one_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    if find_spec("distributed") is None:
        pytest.skip("dask is not installed: groundtrace[fleet]")
    monkeypatch.chdir(tmp_path)
    walks(tmp_path / "small", 2)
    (tmp_path / "small" / "zjunk.mcap").write_bytes(b"this is no recording")
    command = ("small", "--pipeline", "waist-peaks", "--force", "-o", "t.parquet")
    digests = [
        ran_fleet(capsys, *command, "--engine", engine, "--workers", 1)["digest"]
        for engine in ("local", "dask")
    ]
    use(monkeypatch, Here())
    digests.append(ran_fleet(capsys, *command)["digest"])
    assert len(set(digests)) == 1


@pytest.mark.parametrize(
    ("package", "engine", "extra"), [("distributed", "dask", "fleet"), ("ray", "ray", "ray")]
)
def test_a_missing_package_is_said_with_what_installs_it(
    package: str,
    engine: str,
    extra: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: Capture,
) -> None:
    monkeypatch.setattr("groundtrace.fleet.engines.find_spec", lambda _: None)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.mcap").write_bytes(b"")
    said = run(capsys, "fleet", "a.mcap", "-o", "t.parquet", "--engine", engine).error
    assert said == (
        f"--engine {package}: expected the package {package}, found none; "
        f"install it with: pip install 'groundtrace[{extra}]'"
    )


def test_a_worker_that_ends_itself_is_not_tried_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FLEET_TEST_MARKER", str(tmp_path / "ran"))
    assert list(LocalEngine(1).run(overdue, [3])) == [(0, None)]
    assert (tmp_path / "ran").read_text("utf-8") == "once\n"


@pytest.mark.parametrize(
    ("package", "engine"),
    [("distributed", "dask:tcp://127.0.0.1:9"), ("ray", "ray:ray://127.0.0.1:9")],
)
def test_a_cluster_that_does_not_answer_is_one_line_soon(
    package: str,
    engine: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: Capture,
) -> None:
    if find_spec(package) is None:
        pytest.skip(f"{package} is not installed")
    monkeypatch.chdir(tmp_path)
    walks(tmp_path / "small", 1, 4.0)
    began = time.monotonic()
    said = run(capsys, "fleet", "small", "-o", "t.parquet", "--engine", engine).error
    assert said.startswith(f"--engine {engine}: expected a cluster, found: ")
    assert time.monotonic() - began < 15.0
