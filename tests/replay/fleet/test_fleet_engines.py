"""Engines: every task once, a killed worker costs only its task, one table whatever computes it."""

from __future__ import annotations

import time
from collections import Counter
from contextlib import contextmanager
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import pytest
from command_runs import run
from fleet_runs import Here, but_not_on_the_first, overdue, ran_fleet, refused, twice, use, walks

from groundtrace.errors import RecordingError
from groundtrace.fleet.engines import Engine, MisfitError, WorkerLostError, engine_of

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Mapping
    from pathlib import Path

Capture = pytest.CaptureFixture[str]


def test_a_killed_worker_is_replaced_and_its_task_tried_once_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    marker = tmp_path / "killed"
    monkeypatch.setenv("FLEET_TEST_MARKER", str(marker))
    tasks = [1, 7, 13, 4, 5]
    answers = dict(engine_of("local", 2).run(twice, tasks))
    assert answers == {0: 2, 1: 14, 2: None, 3: 8, 4: 10}
    kills = {p.name: len(p.read_text("utf-8").split()) for p in tmp_path.iterdir()}
    assert kills == {"killed-7": 1, "killed-13": 2}


def test_closing_the_answers_ends_the_workers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from multiprocessing import active_children

    monkeypatch.setenv("FLEET_TEST_MARKER", str(tmp_path / "killed"))
    answers = engine_of("local", 1).run(twice, [1, 2, 3])
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
    assert list(engine_of("local", 1).run(overdue, [3])) == [(0, None)]
    assert (tmp_path / "ran").read_text("utf-8") == "once\n"


@pytest.mark.sweep
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


class Told:
    """A crew without processes: what becomes of each task of a worker is written down.

    Parameters
    ----------
    rooms
        How many tasks each worker does at once.
    act
        Is given worker and task; returns the answer, or raises.
    """

    def __init__(self, rooms: dict[str, int], act: Callable[[str, int], Any]) -> None:
        self.rooms, self.act = rooms, act
        self.number = 0
        self.given: dict[int, tuple[str, int]] = {}
        self.most: Counter[str] = Counter()
        self.beside: dict[int, int] = {}

    def there(self, _: int) -> Mapping[str, int]:
        return dict(self.rooms)

    def give(self, worker: str, _: object, task: int) -> int:
        self.number += 1
        self.given[self.number] = (worker, task)
        busy = sum(who == worker for who, _ in self.given.values())
        self.most[worker] = max(self.most[worker], busy)
        self.beside[task] = busy - 1
        return self.number

    def ended(self, given: Collection[int], _: float) -> list[int]:
        return list(given)

    def answer(self, given: int) -> Any:
        return self.act(*self.given.pop(given))

    def answers(self, tasks: list[int], told: list[str] | None = None) -> dict[int, Any]:
        @contextmanager
        def opened() -> Iterator[Any]:
            yield self

        return dict(
            Engine("told", opened).run(abs, tasks, (told if told is not None else []).append)
        )


def test_a_worker_that_refuses_is_left_out_and_others_do_its_tasks() -> None:
    def act(worker: str, task: int) -> int:
        if worker == "old":
            raise MisfitError("elsewhere: expected numpy 2, found numpy 1")
        if worker == "bare":
            raise ModuleNotFoundError("No module named 'groundtrace'")
        return 10 * task

    told: list[str] = []
    crew = Told({"old": 2, "bare": 1, "good": 1}, act)
    assert crew.answers([0, 1, 2, 3, 4], told) == {0: 0, 1: 10, 2: 20, 3: 30, 4: 40}
    assert told == [
        "worker old is left out: elsewhere: expected numpy 2, found numpy 1",
        "worker bare is left out: expected an answer, found: ModuleNotFoundError: "
        "No module named 'groundtrace'",
    ]
    assert crew.most == {"old": 2, "bare": 1, "good": 1}


def test_where_every_worker_refuses_the_run_ends_in_one_line() -> None:
    def act(*_: object) -> None:
        raise MisfitError("expected numpy 2, found numpy 1")

    with pytest.raises(RecordingError) as ended:
        Told({"a": 1, "b": 1}, act).answers([1, 2, 3])
    assert str(ended.value) == (
        "--engine told: expected a worker to use, found 2 left out, the first, a: "
        "expected numpy 2, found numpy 1"
    )


def test_a_task_whose_worker_goes_away_is_done_by_another(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("groundtrace.fleet.engines._LOOK_S", 0.0)
    crew = Told({"a": 1, "b": 1}, lambda _, task: task)
    ended = crew.ended

    def some(given: Collection[int], wait_s: float) -> list[int]:
        crew.rooms.pop("a", None)
        return [number for number in ended(given, wait_s) if crew.given[number][0] == "b"]

    monkeypatch.setattr(crew, "ended", some)
    assert crew.answers([5, 6, 7]) == {0: 5, 1: 6, 2: 7}


def test_who_was_beside_a_task_that_kills_is_not_blamed_for_it() -> None:
    def act(_: str, task: int) -> int:
        kills = task == 13 or (crew.beside[13] > 0 and task in (1, 2))
        if kills:
            raise WorkerLostError
        return task

    crew = Told({"a": 4}, act)
    assert crew.answers([13, 1, 2, 3]) == {0: None, 1: 1, 2: 2, 3: 3}
    assert crew.beside[13] == 0


def test_a_cluster_without_workers_is_one_line_after_a_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    distributed = pytest.importorskip("distributed", reason="groundtrace[fleet]")
    monkeypatch.setattr("groundtrace.fleet.engines.WORKERS_S", 1.0)
    monkeypatch.chdir(tmp_path)
    walks(tmp_path / "small", 1, 4.0)
    with distributed.LocalCluster(n_workers=0, dashboard_address=":0") as cluster:
        engine = f"dask:{cluster.scheduler_address}"
        said = run(capsys, "fleet", "small", "-o", "t.parquet", "--engine", engine).error
    assert said == f"--engine {engine}: expected a worker within 1 s, found none"
    assert not (tmp_path / "t.parts").exists()


def test_a_worker_of_dask_with_other_code_is_left_out() -> None:
    distributed = pytest.importorskip("distributed", reason="groundtrace[fleet]")
    told: list[str] = []
    options = {"n_workers": 2, "threads_per_worker": 1, "processes": False}
    with distributed.LocalCluster(dashboard_address=":0", **options) as cluster:
        engine = engine_of(f"dask:{cluster.scheduler_address}", 1)
        answers = dict(engine.run(but_not_on_the_first, list(range(6)), told.append))
    assert answers == {number: -number for number in range(6)}
    assert len(told) == 1
    assert told[0].endswith(" is left out: expected another worker, found the first")


def test_a_process_that_refuses_is_not_replaced_by_another_that_does() -> None:
    with pytest.raises(RecordingError, match=r"found 2 left out, the first, process \d+: expected"):
        dict(engine_of("local", 2).run(refused, [1, 2, 3]))
