"""What commands print: one JSON document on stdout, or lines for people."""

from __future__ import annotations

import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Protocol

import msgspec

from ..api.document import plain_document
from ..api.files import existing as existing
from ..api.files import writable as writable

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from ..warned import Warned


def print_json(document: Any, warnings: Sequence[Warned] | None = None) -> None:
    """Print one JSON document on stdout; a number that is not finite is null.

    Parameters
    ----------
    document
        An object.
    warnings
        What a replay warned of: becomes its property ``warnings``, unless None.
    """
    plain = plain_document(document, warnings)
    print(msgspec.json.format(msgspec.json.encode(plain), indent=2).decode())


def say(text: str) -> None:
    """Print a line of progress or a remark on stderr."""
    print(text, file=sys.stderr)


def print_warnings(warnings: Iterable[Warned]) -> None:
    """Print what a replay warned of, a line each, on stdout: before what rests on it."""
    for warned in warnings:
        print(f"warning: {warned.line}")


def print_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print aligned columns on stdout."""
    widths = [max(len(row[i]) for row in [header, *rows]) for i in range(len(header))]
    for row in [header, *rows]:
        line = "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        print(line.rstrip())


class Show(Protocol):
    """Shows how much is done."""

    def __call__(self, done: float, total: float | None = None, /) -> None:
        """Take what is done, and of how much where that was not known before."""


@contextmanager
def progress(
    total: float | None, what: str, unit: str = "s", *, quiet: bool = False
) -> Iterator[Show]:
    """Show how much of ``total`` is done, how fast, and the time left, on a terminal only.

    Parameters
    ----------
    total
        Seconds of recording, or another unit; None where it is not known yet.
    what
        What goes on.
    unit
        Of ``total``; a rate in seconds a second is that of real time.
    quiet
        Show nothing.
    """
    if quiet or not sys.stderr.isatty():
        yield lambda _done, _total=None: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, ProgressColumn, TextColumn, TimeRemainingColumn
    from rich.text import Text

    class Rate(ProgressColumn):
        def render(self, task: Any) -> Text:
            rate = task.finished_speed or task.speed
            known = "" if rate is None else f"{rate:.3g} " + ("x" if unit == "s" else f"{unit}/s")
            return Text(known.rjust(10))

    class Done(ProgressColumn):
        def render(self, task: Any) -> Text:
            of = "" if task.total is None else f" of {task.total:.0f}"
            return Text(f"{task.completed:.0f}{of} {unit}")

    columns = (TextColumn(what), BarColumn(), Done(), Rate(), TimeRemainingColumn())
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(what, total=total)
        yield lambda done, of=None: bar.update(task, completed=done, total=of)
