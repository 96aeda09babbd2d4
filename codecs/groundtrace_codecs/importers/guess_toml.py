"""A guessed map as TOML, with what was guessed as comments."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from .guess_time import PLACEHOLDER_HZ

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from .guess import Remark
    from .guess_columns import Column
    from .guess_counter import GuessedCounter
    from .guess_table import RawTable
    from .guess_time import GuessedTime


def as_toml(
    table: RawTable,
    time: GuessedTime | None,
    counter: GuessedCounter | None,
    groups: Mapping[str, Sequence[Column]],
    remarks: Sequence[Remark],
) -> str:
    """Return the text of a map."""
    lines = ["# Guessed by groundtrace import --guess: check it, then import with --map."]
    lines += [f"# {_plain(remark_line(r))}" for r in remarks]
    lines += [
        'format = "csv"',
        f"delimiter = {_text(table.delimiter)}",
        f"decimal = {_text(table.decimal)}",
        'comment = ""',
        f"skip_rows = {table.skip_rows}",
        f"encoding = {_text(table.encoding)}",
    ]
    if time is None:
        lines.append(f"rate_hz = {PLACEHOLDER_HZ}")
    else:
        lines.append(f"time = {{column = {_key(table, time.column)}, unit = {_text(time.unit)}}}")
    if counter is not None:
        wraps = "" if counter.modulus is None else f", modulus = {counter.modulus}"
        lines.append(f"counter = {{column = {_key(table, counter.column)}{wraps}}}")
    for topic, columns in groups.items():
        lines += ["", "[[stream]]", f"topic = {_text(topic)}", "columns = ["]
        lines += [f"  {_column(table, c)}," for c in columns]
        lines.append("]")
    return "\n".join(lines) + "\n"


def remark_line(remark: Remark) -> str:
    """Return one guess as a line."""
    sure = f" ({remark.sureness}: {remark.why})" if remark.sureness else f" ({remark.why})"
    return f"{remark.about}: {remark.taken}{sure}"


def _column(table: RawTable, column: Column) -> str:
    axis = f", axis = {_text(column.axis)}" if column.axis else ""
    return (
        f"{{column = {_key(table, column.place)}, quantity = {_text(column.quantity)}, "
        f"unit = {_text(column.unit)}{axis}}}"
    )


def _key(table: RawTable, index: int) -> str:
    key = table.key(index)
    return _text(key) if isinstance(key, str) else str(key)


def _text(text: str) -> str:
    """Return a TOML basic string, whose escapes are those of JSON but for DEL."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _plain(text: str) -> str:
    """Return a comment without what TOML forbids there."""
    return "".join(c if c.isprintable() else " " for c in text)
