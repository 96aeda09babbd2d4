"""What commands print: one JSON document on stdout, or lines for people."""

from __future__ import annotations

import math
import sys
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import msgspec

from groundtrace_codecs.mcap.remote import is_url

from ..errors import RecordingError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from ..warned import Warned


#: What a copy does to a recording whose clock was set back.
SET_BACK = (
    "a clock was set back while it was recorded, and messages are written in the order of their "
    "log times: where times come twice, what was recorded before and after is mixed in the new file"
)


def print_json(document: Any, warnings: Sequence[Warned] | None = None) -> None:
    """Print one JSON document on stdout; a number that is not finite is null.

    Parameters
    ----------
    document
        An object.
    warnings
        What a replay warned of: becomes its property ``warnings``, unless None.
    """
    plain = _finite(msgspec.to_builtins(document, enc_hook=str))
    if warnings is not None:
        plain["warnings"] = [warned.document for warned in warnings]
    print(msgspec.json.format(msgspec.json.encode(plain), indent=2).decode())


def _finite(value: Any) -> Any:
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return value


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


def existing(path: Path, what: str = "a recording") -> Path:
    """Return a path that is a readable file, or a URL, which is known when it is opened.

    Raises
    ------
    RecordingError
        Where there is no such file.
    """
    if not (path.is_file() or is_url(path)):
        raise RecordingError(f"{path}: expected {what}, found no such file")
    return path


def writable(path: Path, *, force: bool, sources: Sequence[Path] = ()) -> Path:
    """Return a path that may be written while ``sources`` are read.

    Raises
    ------
    RecordingError
        Where the file exists and ``force`` is not given, it is a folder or one of ``sources``, or
        its folder does not exist.
    """
    if not path.resolve().parent.is_dir():
        raise RecordingError(f"{path}: expected an existing folder, found none")
    if path.is_dir():
        raise RecordingError(f"{path}: expected a file to write, found a folder")
    if path.resolve() in (source.resolve() for source in sources):
        raise RecordingError(f"{path}: expected a new file, found the one that is read")
    if path.exists() and not force:
        raise RecordingError(f"{path}: expected a new file, found an existing one; see --force")
    return path


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
