"""Commands run in this process, and what their results say."""

from __future__ import annotations

import io
import json
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from jsonschema import Draft202012Validator

from groundtrace.cli.main import main
from groundtrace.pipeline.conformance import Outcome, assert_same, outcome
from groundtrace.pipeline.results import read_results

if TYPE_CHECKING:
    from collections.abc import Iterable

    import pytest

    from groundtrace_codecs.events import Event

SCHEMAS = Path(__file__).parents[2] / "docs" / "json"


class Ran(NamedTuple):
    """What a command left behind."""

    code: int
    out: str
    err: str

    @property
    def document(self) -> Any:
        """The one JSON document that is all of stdout."""
        return json.loads(self.out)

    @property
    def error(self) -> str:
        """The one line that a known error says, or wrong usage."""
        assert self.code in (1, 2), (self.code, self.err)
        assert self.out == ""
        lines = self.err.splitlines()
        assert len(lines) == 1, self.err
        assert lines[0].startswith("groundtrace: ")
        return lines[0].removeprefix("groundtrace: ")


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> Ran:
    """Run a command and return what it left behind."""
    capsys.readouterr()
    code = _ended(arguments)
    return Ran(code, *capsys.readouterr())


def printed(*arguments: object) -> tuple[int, str]:
    """Run a command; return its exit code, and what it printed on both streams in their order."""
    both = io.StringIO()
    with redirect_stdout(both), redirect_stderr(both):
        code = _ended(arguments)
    return code, both.getvalue()


def _ended(arguments: Iterable[object]) -> int:
    try:
        main([str(argument) for argument in arguments])
    except SystemExit as end:
        return int(end.code or 0)
    return 0


def done(capsys: pytest.CaptureFixture[str], *arguments: object, losses: bool = False) -> Ran:
    """Run a command that must succeed; with ``losses`` it must say so."""
    ran = run(capsys, *arguments)
    assert ran.code == (3 if losses else 0), ran.err
    return ran


def check_schema(command: str, document: Any) -> None:
    """Raise where a command's document is not as its schema in docs/json says."""
    schema = json.loads((SCHEMAS / f"{command}.schema.json").read_text("utf-8"))
    Draft202012Validator(schema).validate(document)


def decisions(results: Path) -> dict[str, Outcome]:
    """Return what each stage decided, by its name."""
    return decided_by(read_results(results).events)


def decided_by(found: Iterable[Event]) -> dict[str, Outcome]:
    """Return what each stage decided, by its name, among events."""
    events = [e for e in found if stage_of(e)]
    names = dict.fromkeys(map(stage_of, events))
    return {name: outcome(e for e in events if stage_of(e) == name) for name in names}


def stage_of(event: Any) -> str:
    """Return the stage an event comes from, or nothing."""
    return str(event.spec.stage if hasattr(event, "spec") else getattr(event, "stage", ""))


def assert_same_decisions(one: Path, other: Path) -> None:
    """Raise where two results differ in any candidate, verdict or event."""
    assert_decided_alike(decisions(one), decisions(other), f"{one.name} and {other.name}")


def assert_decided_alike(first: dict[str, Outcome], second: dict[str, Outcome], what: str) -> None:
    """Raise where stages decided otherwise, in any candidate, verdict or event."""
    assert first.keys() == second.keys()
    assert any(len(found.times) for found in first.values())
    for stage, found in first.items():
        assert_same(found, second[stage], f"{what}: {stage}")
