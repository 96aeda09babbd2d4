"""Small fleets for tests: recordings of a few seconds, and engines that start no process."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from typing import TYPE_CHECKING, Any

from command_runs import check_schema, run

from groundtrace.fleet.engines import OVERDUE, MisfitError
from groundtrace.simulate.gait import WalkOptions
from groundtrace.simulate.recording import write
from groundtrace.simulate.walk import simulate_walk

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    import pytest


def walks(folder: Path, count: int, seconds: float = 8.0) -> list[Path]:
    """Write walks of a waist sensor with truth, each of another seed."""
    folder.mkdir(exist_ok=True)
    paths = [folder / f"walk-{number}.mcap" for number in range(1, count + 1)]
    for number, path in enumerate(paths, 1):
        write(simulate_walk(WalkOptions(seed=number, duration_s=seconds)), path)
    return paths


class Here:
    """Does the work in this process, the last task first; may be interrupted after some."""

    def __init__(self, interrupted_after: int | None = None, lost: frozenset[int] = frozenset()):
        self.left = interrupted_after
        self.lost = lost
        self.given: list[Any] = []

    def run(
        self, function: Callable[[Any], Any], tasks: Sequence[Any], _: object
    ) -> Iterator[tuple[int, Any]]:
        for number in reversed(range(len(tasks))):
            if self.left == 0:
                raise KeyboardInterrupt
            self.left = None if self.left is None else self.left - 1
            self.given.append(tasks[number])
            yield number, None if number in self.lost else function(tasks[number])


def ran_fleet(capsys: pytest.CaptureFixture[str], *arguments: object) -> Any:
    """Run ``groundtrace fleet --json``; its document, whose errors its exit code must tell."""
    ran = run(capsys, "fleet", *arguments, "--json")
    said = ran.document
    rows, errors = said["rows"], said["errors"]
    if said["table"] is None:
        rows, errors = said["done"] + said["known"] + said["failed"], said["failed"]
    assert ran.code == (0 if not errors else 3 if errors < rows else 1), ran.err
    check_schema("fleet", said)
    return said


def use(monkeypatch: pytest.MonkeyPatch, engine: Any) -> Any:
    """Let the command line use an engine, whatever is asked for."""
    monkeypatch.setattr("groundtrace.cli.fleet.engine_of", lambda *_: engine)
    return engine


def twice(number: int) -> int:
    """Return a number doubled, or kill this process: at 13 always, at 7 the first time."""
    marker = Path(f"{os.environ['FLEET_TEST_MARKER']}-{number}")
    if number == 13 or (number == 7 and not marker.exists()):
        with marker.open("a", encoding="utf-8") as stream:
            stream.write("killed\n")
        os.kill(os.getpid(), signal.SIGKILL)
    return 2 * number


def overdue(_: int) -> None:
    """End this process as a worker does that hears nothing, and note that it ran."""
    with Path(os.environ["FLEET_TEST_MARKER"]).open("a", encoding="utf-8") as stream:
        stream.write("once\n")
    os._exit(OVERDUE)


def refused(_: int) -> None:
    """Say that this worker is not one of the run."""
    raise MisfitError("expected another worker, found this one")


def but_not_on_the_first(number: int) -> int:
    """Return a number turned about, on every worker of Dask but the first."""
    from distributed import get_worker

    if get_worker().name == 0:
        raise MisfitError("expected another worker, found the first")
    return -number
