"""Output of commands: one JSON document on stdout, or lines for people."""

from __future__ import annotations

import os
import shlex
import sys
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from groundtrace_codecs.location import as_url, is_url

from ..api.progress import unseen
from ..visible import visible

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from groundtrace_codecs.mcap.chunks import Damage

    from ..api.progress import Show
    from ..pipeline.warned import Warned


def print_json(document: Any, warnings: Sequence[Warned] | None = None) -> None:
    """Print one JSON document on stdout; a number that is not finite is null.

    Parameters
    ----------
    document
        An object.
    warnings
        What a replay warned of: becomes its property ``warnings``, unless None.
    """
    from ..api.tables import plain_document  # loads numpy, which lines for people do not need

    plain = plain_document(document, warnings)
    print_line(msgspec.json.format(msgspec.json.encode(plain), indent=2).decode())


def print_line(text: str = "", end: str = "\n") -> None:
    """Print a line on stdout."""
    print(visible(text), end=end)


def print_stderr(text: str) -> None:
    """Print a line of progress or a remark on stderr."""
    print(visible(text), file=sys.stderr)


def print_warnings(warnings: Iterable[Warned]) -> None:
    """Print what a replay warned of, a line each, on stdout: before what rests on it."""
    for warned in warnings:
        print_line(f"warning: {warned.line}")


def print_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print aligned columns on stdout."""
    widths = [max(len(row[i]) for row in [header, *rows]) for i in range(len(header))]
    for row in [header, *rows]:
        line = "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        print_line(line.rstrip())


@contextmanager
def progress(
    total: float | None, what: str, unit: str = "s", /, *, quiet: bool = False
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
        with unseen(total, what, unit) as show:
            yield show
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, ProgressColumn, TextColumn, TimeRemainingColumn
    from rich.text import Text

    class Rate(ProgressColumn):
        def render(self, task: Any) -> Text:
            rate = task.finished_speed or task.speed
            speed_text = (
                "" if rate is None else f"{rate:.3g} " + ("x" if unit == "s" else f"{unit}/s")
            )
            return Text(speed_text.rjust(10))

    class Done(ProgressColumn):
        def render(self, task: Any) -> Text:
            of = "" if task.total is None else f" of {task.total:.0f}"
            return Text(f"{task.completed:.0f}{of} {unit}")

    columns = (
        TextColumn(visible(what), markup=False),
        BarColumn(),
        Done(),
        Rate(),
        TimeRemainingColumn(),
    )
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(what, total=total)
        yield lambda done, of=None: bar.update(task, completed=done, total=of)


def counted(count: int, noun: str, plural: str = "") -> str:
    """Return a count with its noun, which agrees: ``1 place``, ``2 places``."""
    return f"{count} {noun if count == 1 else plural or f'{noun}s'}"


def lost_messages(count: int | None) -> str:
    """Return how many messages are lost, with a space behind; nothing where none is."""
    if count is None:
        return "unknown number of messages lost "
    return f"{counted(count, 'message')} lost " if count else ""


def damage_text(damage: Damage) -> str:
    """Return what is wrong at a place, and what that costs where something is lost."""
    heading = ", ".join(filter(None, ("damage", lost_messages(damage.messages).rstrip())))
    return f"{heading}: {damage.reason}"


def quoted(path: Path) -> str:
    """Return a path, or a URL that was made one, as one types it in a shell."""
    return shlex.quote(as_url(path) if is_url(path) else str(path))


def has_display() -> bool:
    """Whether a window can open here."""
    if sys.platform in {"win32", "darwin"}:
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def where_to_show(
    rrd: Path | None, fallback: Path, checked: Callable[[Path], Path], *, spawn: bool
) -> tuple[bool, Path | None]:
    """Return whether to open the viewer, and which file to write.

    Parameters
    ----------
    rrd
        The file asked for.
    fallback
        The file that is written where a viewer was asked for and there is no display.
    checked
        Returns a path that may be written, or raises.
    spawn
        Whether a viewer was asked for.
    """
    if rrd is not None:
        checked(rrd)
    if spawn and not has_display():
        print_stderr("no display: the viewer's file is written instead")
        return False, rrd or checked(fallback)
    return spawn, rrd
