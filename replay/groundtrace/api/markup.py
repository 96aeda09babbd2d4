"""Tables in notebooks: HTML of a few rows, escaped, without scripts and without a network."""

from __future__ import annotations

import math
from html import escape
from itertools import islice
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

#: A table in a notebook has at most so many rows.
ROWS = 12


def html_table(
    title: str, header: Sequence[str], rows: Iterable[Sequence[Any]], count: int | None = None
) -> str:
    """Return a table of at most :data:`ROWS` rows, all text escaped.

    Parameters
    ----------
    title
        What stands above it.
    header
        Names of the columns.
    rows
        Cells; of more than :data:`ROWS` rows the last one shown says how many there are.
    count
        How many rows there are, where ``rows`` may be only the first of them.
    """
    shown = list(rows if count is None else islice(rows, ROWS))
    there = len(shown) if count is None else count
    if there > ROWS:
        shown = shown[: ROWS - 1]
    head = "".join(f"<th>{escape(name)}</th>" for name in header)
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(cell_text(cell))}</td>" for cell in row) + "</tr>"
        for row in shown
    )
    if there > ROWS:
        body += f'<tr><td colspan="{max(len(header), 1)}">… {there - len(shown)} more</td></tr>'
    return (
        f"<table><caption>{escape(title)}</caption>"
        f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
    )


def cell_text(value: Any) -> str:
    """Return a cell as people read it: six digits of a number, nothing of what is not there."""
    if value is None:
        return ""
    if hasattr(value, "item"):
        value = value.item()
    if isinstance(value, float):
        return f"{value:.6g}" if math.isfinite(value) else str(value)
    return str(value)
