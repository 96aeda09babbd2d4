"""What changed between two fleets, on the newer one's page."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

import numpy as np

from ..score.html_parts import section, table
from .measures import FEWEST, changes, pairs_of
from .report_rows import figure

if TYPE_CHECKING:
    from .measures import Change
    from .reading import FleetTable

#: Recordings listed to either side.
LISTED = 12


def changes_section(old: FleetTable, new: FleetTable) -> str:
    """Return the section that judges a fleet against an earlier one."""
    found = changes(old, new)
    pairs = pairs_of(old, new)
    said = (
        f"<p>Against {escape(old.name)}: {len(pairs)} rows are of recordings with the same bytes. "
        "The interval holds nine of ten changes when recordings are drawn again with replacement, "
        "both fleets with the same ones; better and worse are said where all of it is on one side "
        f"of no change. Of fewer than {FEWEST} recordings nothing is said.</p>"
    )
    if not found:
        return section("What changed", said + "<p>No figure is in both tables.</p>")
    return section("What changed", said + _figures(found) + _recordings(old, new, pairs))


def _figures(found: list[Change]) -> str:
    header = ("figure", "pipeline", "recordings", "before", "now", "change", "interval", "verdict")
    head = "".join(f'<th scope="col">{name}</th>' for name in header)
    body = "".join(_row(change) for change in found)
    return (
        f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>'
        "</div>"
    )


def change_cells(change: Change) -> list[str]:
    """Return a change as text: figure, pipeline, recordings, before, now, change, interval."""
    measure, interval = change.measure, change.interval
    said = ""
    if interval is not None:
        low, high = (figure(end, measure, sign=True) for end in (interval.low, interval.high))
        said = f"{low} to {high}"
    return [
        measure.name + (f" [{measure.unit}]" if measure.unit else ""),
        change.pipeline,
        str(change.recordings),
        figure(change.before, measure),
        figure(change.after, measure),
        figure(change.after - change.before, measure, sign=True),
        said,
    ]


def _row(change: Change) -> str:
    cells = "".join(f"<td>{escape(cell)}</td>" for cell in change_cells(change))
    style = change.verdict if change.verdict in ("better", "worse") else "sub"
    return f'<tr>{cells}<td class="{style}">{change.verdict}</td></tr>'


def _recordings(old: FleetTable, new: FleetTable, pairs: list[tuple[int, int]]) -> str:
    """Return the recordings whose F1 fell and rose most, and those that fail now or no more."""
    before, after = old.numbers("steps_f1"), new.numbers("steps_f1")
    moved = np.array([after[b] - before[a] for a, b in pairs], np.float64)
    order = [int(i) for i in np.argsort(moved, kind="stable") if np.isfinite(moved[i])]
    fell = [i for i in order if moved[i] < 0][:LISTED]
    rose = [i for i in reversed(order) if moved[i] > 0][:LISTED]
    parts = ""
    for title, rows in (("F1 fell most", fell), ("F1 rose most", rose)):
        cells = [
            [
                new.of("location")[pairs[i][1]],
                new.of("pipeline")[pairs[i][1]],
                f"{before[pairs[i][0]]:.3f}",
                f"{after[pairs[i][1]]:.3f}",
                f"{moved[i]:+.3f}",
            ]
            for i in rows
        ]
        if cells:
            parts += table(title, ("recording", "pipeline", "before", "now", "change"), cells)
    return parts + _failures(old, new, pairs)


def _failures(old: FleetTable, new: FleetTable, pairs: list[tuple[int, int]]) -> str:
    was, now = old.of("error"), new.of("error")
    cells = [
        [new.of("location")[b], new.of("pipeline")[b], was[a] or "none", now[b] or "none"]
        for a, b in pairs
        if bool(was[a]) != bool(now[b])
    ]
    header = ("recording", "pipeline", "error before", "error now")
    return table("Fail now, or no more", header, cells) if cells else ""
