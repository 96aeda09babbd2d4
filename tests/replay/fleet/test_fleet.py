"""Fleets: what the tables hold, what goes on after an interruption, what is refused."""

from __future__ import annotations

import importlib
import json
import os
import platform
import shutil
import time
from contextlib import suppress
from dataclasses import fields, is_dataclass, replace
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from types import SimpleNamespace
from typing import Any

import pytest
from command_runs import check_schema, done, run
from fleet_runs import Here, ran_fleet, use, walks
from pyarrow import concat_tables, parquet

from groundtrace.evaluation import __path__ as score_path
from groundtrace.fleet import run as fleet_run
from groundtrace.fleet.engines import MisfitError
from groundtrace.fleet.run import (
    Recipe,
    Software,
    Task,
    TimeLimit,
    TimeLimitError,
    evaluate,
    misfit,
    recipes_of,
    tasks_of,
)
from groundtrace.fleet.table import FIGURES, decoded
from groundtrace.simulate.gait import WalkOptions
from groundtrace.simulate.recording import write
from groundtrace.simulate.room import simulate_room
from groundtrace.simulate.room_plan import RoomOptions
from groundtrace.simulate.walk import simulate_walk
from groundtrace_codecs.copies import convert
from groundtrace_codecs.location import Location

Capture = pytest.CaptureFixture[str]
WAIST = ("--pipeline", "waist-peaks")


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two walks, one that is torn, and one file that is no recording."""
    folder = tmp_path_factory.mktemp("fleet") / "small"
    paths = walks(folder, 3)
    many = folder / "many-chunks.mcap"
    convert(paths[2], many, chunk_bytes=64 << 10)
    whole = many.read_bytes()
    many.unlink()
    paths[2].write_bytes(whole[: len(whole) * 4 // 5])
    (folder / "zjunk.mcap").write_bytes(b"this is no recording")
    return folder


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(small: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copytree(small, tmp_path / "small")
    monkeypatch.chdir(tmp_path)


def ran(capsys: Capture, *arguments: object) -> Any:
    return ran_fleet(capsys, "small", "-o", "t.parquet", *arguments)


def rows(path: str = "t.parquet") -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = parquet.read_table(path).to_pylist()
    return found


def test_there_is_a_row_for_each_recording_and_pipeline_and_one_for_each_step(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    use(monkeypatch, Here())
    said = ran(capsys, *WAIST, "--pipeline", "signals")
    table = rows()
    assert [(r["recording"], r["pipeline"]) for r in table] == [
        (name, pipeline)
        for name in ("walk-1.mcap", "walk-2.mcap", "walk-3.mcap", "zjunk.mcap")
        for pipeline in ("waist-peaks", "signals")
    ]
    assert (said["recordings"], said["rows"], said["errors"]) == (4, 8, 2)
    first = table[0]
    assert first["location"] == "small/walk-1.mcap"
    assert first["duration_s"] == pytest.approx(8, abs=0.1)
    assert "/imu/waist" in first["topics"]
    assert "height" in first["parameters"]
    assert "groundtrace" in first["versions"]
    steps = [s for s in rows("t.steps.parquet") if s["pipeline"] == "waist-peaks"]
    for row in table[:6:2]:
        mine = [s["verdict"] for s in steps if s["recording"] == row["recording"]]
        missed = row["steps_truth"] - row["steps_matched"]
        assert mine.count("matched") == row["steps_matched"]
        assert mine.count("missed") == missed
        assert mine.count("false") == row["steps_detected"] - row["steps_matched"]
        assert sum(n or 0 for name, n in row.items() if name.startswith("missed_")) == missed


def test_the_figures_are_those_of_replay_and_score(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    use(monkeypatch, Here())
    room = RoomOptions(duration_s=5.0, channels=4, rate_hz=4000.0)
    write(simulate_room(room), Path("small/room.mcap"))
    ran(capsys)
    for row in rows():
        if row["recording"] not in ("room.mcap", "walk-1.mcap"):
            continue
        replayed = done(capsys, "replay", row["location"], "--no-viewer", "--json").document
        assert row["pipeline"] in ("room-footsteps", "waist-steps")
        scored = done(capsys, "score", replayed["results"], "--json").document
        assert json.loads(row["score_json"]) == scored
        assert row["steps_f1"] == scored["steps"]["f1"]
        assert row["steps_latency_ms_median"] == scored["steps"]["latency_ms"]["median"]
        assert row["samples"] == replayed["samples"]


def test_every_number_of_a_score_is_a_column() -> None:
    modules = [import_module(f"groundtrace.evaluation.{m.name}") for m in iter_modules(score_path)]
    classes = {c.__name__: c for m in modules for c in vars(m).values() if is_dataclass(c)}

    def leaves(kind: Any, prefix: tuple[str, ...]) -> set[tuple[str, ...]]:
        found: set[tuple[str, ...]] = set()
        for field in fields(kind):
            inner = str(field.type).removesuffix(" | None")
            if inner in classes:
                found |= leaves(classes[inner], (*prefix, field.name))
            elif inner in ("int", "float", "str", "bool"):
                found.add((*prefix, field.name))
        return found

    # the tolerance is the row's own, and all picks have no label
    told = {("steps", "tolerance_s"), ("picks", "all", "label")}
    assert leaves(classes["Score"], ()) - told == {figure.path for figure in FIGURES}


def test_what_cannot_be_read_is_a_row_with_its_error_and_what_is_torn_gives_the_rest(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    use(monkeypatch, Here())
    ran(capsys, *WAIST)
    whole, _, torn, junk = rows()
    assert whole["error"] == torn["error"] == ""
    assert whole["damaged_places"] == 0 < torn["damaged_places"]
    assert 0 < torn["samples"] < whole["samples"]
    assert "expected the MCAP magic" in junk["error"]
    assert "small" not in junk["error"]
    assert junk["steps_f1"] is None
    assert junk["missed_threshold"] is None


def test_a_bug_costs_only_its_recording(capsys: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    use(monkeypatch, Here())

    def fail(*_: object, **__: object) -> None:
        raise ZeroDivisionError("nobody expected this")

    monkeypatch.setattr("groundtrace.fleet.run.score_events", fail)
    assert ran(capsys, *WAIST)["errors"] == 4
    assert rows()[0]["error"].startswith("ZeroDivisionError: nobody expected this (test_fleet.py:")


def test_a_worker_killed_twice_is_a_row_with_an_error(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    use(monkeypatch, Here(lost=frozenset({1})))
    assert ran(capsys, *WAIST)["errors"] == 2
    assert (
        rows()[1]["error"]
        == "walk-2.mcap: expected a worker that ends, found it killed twice, or overdue"
    )
    assert len(rows()[1]["sha256"]) == 64
    use(monkeypatch, Here())
    said = ran(capsys, *WAIST, "--resume")
    assert (said["done"], said["known"], said["errors"]) == (1, 2, 1)
    assert rows()[1]["error"] == ""


def test_an_interrupted_run_is_gone_on_with_and_gives_the_same_table(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = use(monkeypatch, Here())
    digest = ran(capsys, *WAIST)["digest"]
    shutil.rmtree("t.parts")
    for path in Path().glob("*.parquet"):
        path.unlink()
    use(monkeypatch, Here(interrupted_after=2))
    ended = run(capsys, "fleet", "small", "-o", "t.parquet", *WAIST)
    assert ended.code == 130
    assert "interrupted: 2 of 4 are done and kept in t.parts; go on with: groundtrace" in ended.err
    assert "--resume" in ended.err
    assert not Path("t.parquet").exists()
    use(monkeypatch, whole)
    said = ran(capsys, *WAIST, "--resume")
    assert said["digest"] == digest
    assert (said["known"], said["done"], said["failed"]) == (1, 2, 1)


def test_resuming_does_again_what_is_not_the_same(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    use(monkeypatch, Here())
    ran(capsys, *WAIST)
    Path("small/walk-1.mcap").touch()
    assert ran(capsys, *WAIST, "--resume")["known"] == 3
    assert ran(capsys, *WAIST, "--resume", "--set", "steps.height=0.5")["known"] == 0
    assert ran(capsys, *WAIST, "--resume", "--tolerance", "0.2")["known"] == 0
    shutil.copy("small/walk-2.mcap", "small/walk-1.mcap")
    assert ran(capsys, *WAIST, "--resume")["known"] == 2
    assert rows()[0]["sha256"] == rows()[1]["sha256"]


def test_shards_give_the_table_of_one_run(capsys: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    engine = use(monkeypatch, Here())
    digest = ran(capsys, *WAIST)["digest"]
    shutil.rmtree("t.parts")
    first = ran(capsys, *WAIST, "--shard", "1/2")
    assert first["table"] is None
    engine.given.clear()
    join = ("fleet", "small", "-o", "t.parquet", *WAIST, "--join")
    refused = run(capsys, *join).error
    said = "t.parts: expected 4 whole parts, found 2; the first that is missing or broken is of "
    assert refused.startswith(said)
    partly = run(capsys, *join, "--partial")
    assert partly.out.splitlines()[-1] == "missing or broken: 2 parts of 4, left out"
    assert partly.code == 3
    assert len(rows()) == 2
    allowed = run(capsys, *join, "--partial", "--allow-failures", "--json")
    check_schema("fleet", allowed.document)
    assert (allowed.code, allowed.document["missing"]) == (0, 2)
    ran(capsys, *WAIST, "--shard", "2/2")
    assert [task.location for task in engine.given] == ["small/zjunk.mcap", "small/walk-2.mcap"]
    engine.given.clear()
    assert ran(capsys, *WAIST, "--join")["digest"] == digest
    assert engine.given == []


@pytest.mark.parametrize("left", [0, 4, 300])
def test_a_part_that_was_copied_in_half_is_left_out_or_made_again(
    left: int, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    use(monkeypatch, Here())
    digest = ran(capsys, *WAIST)["digest"]
    broken = min(Path("t.parts").glob("*.part"))
    broken.write_bytes(broken.read_bytes()[:left])
    join = ("fleet", "small", "-o", "t.parquet", *WAIST, "--join")
    assert "expected 4 whole parts, found 3; the first that is" in run(capsys, *join).error
    partly = run(capsys, *join, "--partial", "--json")
    assert (partly.code, partly.document["missing"], partly.document["rows"]) == (3, 1, 3)
    again = ran(capsys, *WAIST, "--resume")
    assert (again["digest"], again["done"], again["missing"]) == (digest, 1, 0)


def test_truth_comes_from_a_folder_or_from_beside(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    use(monkeypatch, Here())
    Path("truths").mkdir()
    Path("truths/walk-1.truth.csv").write_text("time_s,kind\n1.0,step\n2.0,step\n", "utf-8")
    ran(capsys, *WAIST, "--truth", "truths")
    one, two, *_ = rows()
    assert (one["truth"], one["labels"], one["steps_truth"]) == ("walk-1.truth.csv", 2, 2)
    assert two["truth"] == "recording"


def test_a_part_that_is_not_whole_is_none() -> None:
    assert decoded(b"") is None
    assert decoded(b"\x28\xb5\x2f\xfd nothing") is None


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        (("small", "-o", "t.csv"), "t.csv: expected a name that ends in .parquet, found t.csv"),
        (("none/*.mcap", "-o", "t.parquet"), "none/*.mcap: expected a recording, a folder of"),
        (("small", "-o", "t.parquet", "--shard", "0/2"), "--shard: expected I/N with I from 1"),
        (("small", "-o", "t.parquet", "--engine", "slurm"), "--engine: expected local, dask,"),
        (("small", "-o", "t.parquet", "--truth", "t.csv"), "t.csv: expected a truth file or"),
        (("-o", "t.parquet"), "fleet: expected recordings, found none"),
        (("small", "-o", "t.parquet", "--pipeline", "none"), "none: expected a file or one of"),
        (("small", "-o", "t.parquet", "--set", "a.b=1"), "--set: expected --pipeline NAME"),
        (("small", "-o", "t.parquet", "--partial"), "--partial: expected it with --join, found"),
    ],
)
def test_wrong_arguments_are_refused_in_one_line(
    capsys: Capture, arguments: tuple[str, ...], error: str
) -> None:
    assert run(capsys, "fleet", *arguments).error.startswith(error)
    assert not Path("t.parquet").exists()


def test_a_table_that_is_there_stays_without_force(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    use(monkeypatch, Here())
    ran(capsys, *WAIST)
    assert "see --force" in run(capsys, "fleet", "small", "-o", "t.parquet", *WAIST).error
    ran(capsys, *WAIST, "--force")


def test_the_exit_code_says_whether_recordings_failed(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    use(monkeypatch, Here())
    command = ("fleet", "-o", "t.parquet", *WAIST, "--force")
    assert run(capsys, *command, "small/walk-1.mcap").code == 0
    assert run(capsys, *command, "small/walk-1.mcap", "small/zjunk.mcap").code == 3
    assert run(capsys, *command, "small/zjunk.mcap").code == 1
    assert run(capsys, *command, "small/zjunk.mcap", "--allow-failures").code == 0


@pytest.mark.sweep
def test_a_recording_that_hangs_is_a_row_that_says_so(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    part = fleet_run._part

    def hanging(task: Any, *rest: Any) -> Any:
        while task.location.endswith("walk-1.mcap"):
            time.sleep(0.01)
        return part(task, *rest)

    monkeypatch.setattr(fleet_run, "_part", hanging)
    use(monkeypatch, Here())
    ran(capsys, *WAIST, "--limit-s", "5")
    errors = {row["location"]: row["error"] for row in rows()}
    said = "walk-1.mcap: expected a replay within 5 s, found none"
    assert errors["small/walk-1.mcap"] == said
    assert errors["small/walk-2.mcap"] == ""


def test_what_is_done_in_time_is_not_broken_off_afterwards() -> None:
    here = (platform.node(), os.getpid())
    task = Task(Location("a.mcap"), Recipe("", "", ""), limit_s=0.02, made_by=here)
    undisturbed = 0
    for _ in range(50):
        with suppress(TimeLimitError), TimeLimit(task):
            time.sleep(0.02)
        time.sleep(0.002)  # here it would be raised
        undisturbed += 1
    assert undisturbed == 50


def test_no_module_is_left_half_loaded_by_a_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "slow_to_load.py").write_text(
        "import time\nfor _ in range(40):\n    time.sleep(0.02)\nwhole = True\n", "utf-8"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    here = (platform.node(), os.getpid())
    task = Task(Location("a.mcap"), Recipe("", "", ""), limit_s=0.1, made_by=here)
    slow, broken_off = None, False
    try:
        with TimeLimit(task):
            slow = importlib.import_module("slow_to_load")
            while True:  # what hangs afterwards is broken off
                time.sleep(0.01)
    except TimeLimitError:
        broken_off = True
    assert broken_off
    assert slow is not None
    assert slow.whole


def test_workers_started_elsewhere_find_the_recordings_and_say_which_they_do_not_see(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    class Elsewhere(Here):
        def run(self, function: Any, tasks: Any, left_out: Any) -> Any:
            Path("small/walk-2.mcap").unlink()
            with monkeypatch.context() as there:
                there.chdir("/")
                answers = list(super().run(function, tasks, left_out))
            yield from answers

    use(monkeypatch, Elsewhere())
    ran(capsys, *WAIST)
    errors = {row["location"]: row["error"] for row in rows()}
    assert errors["small/walk-1.mcap"] == ""
    host = platform.node()
    said = f"walk-2.mcap: expected a file, found none visible on worker {host}"
    assert errors["small/walk-2.mcap"] == said


@pytest.mark.parametrize(
    ("software", "told"),
    [
        (Software("f" * 64), f"expected the code of this run, {'f' * 12}, found groundtrace "),
        (Software("", ("python 2.7",)), "expected python 2.7, found python 3."),
        (Software("", ("lisp 1.5",)), "expected lisp 1.5, found none"),
        (Software("", (), ("lisp 1.5",)), "expected lisp 1.5, which has plugins, found none"),
    ],
    ids=("code", "version", "package", "plugin"),
)
def test_a_worker_with_other_software_does_nothing_and_says_so(
    software: Software, told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    (task,) = tasks_of(
        [Location("small/walk-1.mcap")], recipes_of(["waist-peaks"], [], 0.12), 0.12, {}
    )
    assert misfit(task.software) == ""
    assert task.software.owners[0].startswith("groundtrace ")
    with pytest.raises(MisfitError) as refused:
        evaluate(replace(task, software=software))
    assert str(refused.value).startswith(f"{platform.node()}: {told}")


def test_workers_that_are_left_out_are_named_and_counted(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Some(Here):
        def run(self, function: Any, tasks: Any, left_out: Any) -> Any:
            left_out("worker ada is left out: expected python 3.99")
            return super().run(function, tasks, left_out)

    use(monkeypatch, Some())
    done = run(capsys, "fleet", "small", "-o", "t.parquet", *WAIST)
    line = "worker ada is left out: expected python 3.99"
    assert f"workers left out: 1; {line}" in done.out
    assert line in done.err
    assert ran(capsys, *WAIST, "--resume")["left_out"] == [line]


def test_tables_of_any_recordings_have_the_same_columns_and_say_what_made_them(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    use(monkeypatch, Here())
    monkeypatch.setattr("sys.argv", ["groundtrace", "fleet", "/home/ada/small", "-o", "t.parquet"])
    digest = ran(capsys, *WAIST)["digest"]
    ran_fleet(capsys, "small/zjunk.mcap", "-o", "junk.parquet", *WAIST)
    several = [parquet.read_table(name) for name in ("t.parquet", "junk.parquet")]
    assert concat_tables(several).num_rows == 5
    assert several[0].schema.equals(several[1].schema)
    steps = [parquet.read_table(f"{name}.steps.parquet") for name in ("t", "junk")]
    assert concat_tables(steps).num_rows == steps[0].num_rows > 0
    notes = {key.decode(): value.decode() for key, value in several[0].schema.metadata.items()}
    assert notes["groundtrace.decided"] == digest
    assert notes["groundtrace.version"]
    assert notes["groundtrace.command"] == "groundtrace fleet small -o t.parquet"
    assert json.loads(notes["groundtrace.pipelines"]) == {
        "waist-peaks": rows()[0]["pipeline_sha256"]
    }
    units = {
        field.name: field.metadata[b"unit"].decode()
        for table in (several[0], steps[0])
        for field in table.schema
        if field.metadata
    }
    named = ("duration_s", "steps_latency_ms_median", "positions_rmse_m", "error_ms", "bytes")
    assert [units[name] for name in named] == ["s", "ms", "m", "ms", "B"]
    assert not {"steps_f1", "samples", "miss", "text"} & set(units)


def test_subject_and_site_are_those_of_the_metadata(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    use(monkeypatch, Here())
    for number, subject in enumerate(("ada", "bea")):
        walk = simulate_walk(WalkOptions(seed=number, duration_s=8.0))
        session = {"Subject": subject, "site": " hall ", "shoe": "boot"}
        told = replace(walk, metadata={**walk.metadata, "session": session})
        write(told, Path(f"small/told-{number}.mcap"))
    ran(capsys, *WAIST)
    said = {row["recording"]: (row["subject"], row["site"]) for row in rows()}
    assert said["told-0.mcap"] == ("ada", "hall")
    assert said["told-1.mcap"] == ("bea", "hall")
    assert said["walk-1.mcap"] == said["zjunk.mcap"] == ("", "")
    ran_fleet(capsys, "small/told-0.mcap", "small/told-1.mcap", "-o", "told.parquet", *WAIST)
    report = ("fleet-report", "told.parquet", "-o", "told.html", "--against", "told.parquet")
    changes = done(capsys, *report, "--group-by", "subject", "--json").document["changes"]
    assert {change["groups"] for change in changes} == {2}
    missing = run(capsys, "fleet-report", "t.parquet", "-o", "t.html", "--group-by", "subject")
    assert "walk-1.mcap: expected its subject, found none" in missing.error


def test_a_disk_without_room_is_told_first(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine = use(monkeypatch, Here())
    monkeypatch.setattr("shutil.disk_usage", lambda _: SimpleNamespace(free=1000))
    said = run(capsys, "fleet", "small", "-o", "t.parquet", *WAIST).error
    assert said == "t.parquet: expected room for 4 parts, about 0.08 MB, found 0.00 MB"
    assert engine.given == []
