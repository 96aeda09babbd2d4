"""Two tables of the docs as figures: errors in 20 rooms, and how fast a replay is.

    python bench/tables_drawn.py

Writes docs/images/rooms.png from docs/notebook/rooms.md, and docs/images/how-fast.png from
docs/how-fast.md; ``make pictures`` runs it.
"""

from __future__ import annotations

import re
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.ticker import NullFormatter, ScalarFormatter

DOCS = Path(__file__).parents[1] / "docs"
#: Localizers, by their column in the table of rooms, and how they are drawn.
LOCALIZERS = {
    "so-tdoa": (3, "#0072b2", "s"),
    "hyperbolic": (4, "#009e73", "^"),
    "power-law": (5, "#d55e00", "D"),
    "self-calibrating": (6, "#cc79a7", "v"),
    "place": (7, "#56b4e9", "o"),
}
TRACK = 8


def rows_of(page: str, wanted: str) -> list[list[str]]:
    """Return the cells of the rows of a page whose first cell matches."""
    lines = (DOCS / page).read_text("utf-8").splitlines()
    cells = [[c.strip() for c in line.strip("|").split("|")] for line in lines if "|" in line]
    return [row for row in cells if len(row) > 3 and re.fullmatch(wanted, row[0])]


def rooms() -> None:
    """Draw the errors in each room, by the number of sensors."""
    rows = rows_of("notebook/rooms.md", r"\d+")
    rows = list({row[0]: row for row in reversed(rows)}.values())  # the first table, as shipped
    rows.sort(key=lambda row: (int(row[2]), int(row[0])))
    figure, axes = plt.subplots(figsize=(8, 3.6), layout="constrained")
    for number, (name, (column, colour, marker)) in enumerate(LOCALIZERS.items()):
        errors = [[float(v) for v in row[column].split("/")[:2]] for row in rows]
        at = [k + (number - 2.5) * 0.14 for k in range(len(rows))]
        low, high = zip(*errors, strict=True)
        axes.vlines(at, low, high, color=colour, linewidth=1.2, alpha=0.6)
        axes.plot(at, low, marker, color=colour, markersize=4, label=name)
    at = [k + 0.35 for k in range(len(rows))]
    axes.plot(at, [float(row[TRACK]) for row in rows], "o", color="black", label="track, smoothed")
    axes.set(yscale="log", ylim=(0.025, 4))
    axes.yaxis.set_major_formatter(ScalarFormatter())
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.set_yticks([0.05, 0.1, 0.25, 0.5, 1, 2])
    axes.set_xticks(range(len(rows)), [row[2] for row in rows])
    axes.set(xlabel="sensors in the room", ylabel="error [m]: median, line to 95 %")
    axes.grid(axis="y", alpha=0.3)
    axes.legend(ncols=6, fontsize=7.5, loc="upper right")
    figure.savefig(DOCS / "images" / "rooms.png", dpi=130)


def how_fast() -> None:
    """Draw the processor time of each row, ours and others'."""
    rows = rows_of("how-fast.md", r"[^-].*")
    rows = [row for row in rows if re.fullmatch(r"\d+\.\d+", row[1])]
    names = [re.sub(r"[*`]", "", row[0]) for row in rows]
    times = [float(row[1]) for row in rows]
    ours = [name.startswith(("replay", "room-footsteps")) for name in names]
    colours = ["#d55e00" if is_ours else "#888888" for is_ours in ours]
    figure, axes = plt.subplots(figsize=(8, 3.6), layout="constrained")
    bars = axes.barh(names, times, color=colours)
    axes.bar_label(bars, [f"{t:.2f}" for t in times], padding=3, fontsize=8)
    axes.invert_yaxis()
    axes.spines[["top", "right"]].set_visible(False)
    axes.set_xlabel(
        "processor time for a second of 16 channels at 20 kHz [ms]; orange: groundtrace"
    )
    axes.tick_params(axis="y", labelsize=8)
    figure.savefig(DOCS / "images" / "how-fast.png", dpi=130)


if __name__ == "__main__":
    rooms()
    how_fast()
