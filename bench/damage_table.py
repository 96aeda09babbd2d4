"""How much of every damaged file of the damage set is read, as docs/notebook/damage.md has it.

Run: python bench/damage_table.py
"""

from __future__ import annotations

import io
import sys
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))

from mcap.reader import make_reader
from mcap_damage_set import damage_set
from mcap_files import opened, read, rows_of


def package_rows(data: bytes) -> tuple[list[tuple[int, int, int, int, bytes]], str]:
    """Return what the mcap package reads by default before it stops, and the error it stops at."""
    rows = []
    try:
        for _, _, m in make_reader(io.BytesIO(data)).iter_messages():
            rows.append((m.channel_id, m.sequence, m.log_time, m.publish_time, m.data))
    except Exception as error:
        return rows, type(error).__name__
    return rows, ""


def row(broken: bytes, sound: bytes) -> tuple[str, ...]:
    """Return the cells of one file; wrong messages are in the second and in the last."""
    original = Counter(rows_of(sound))
    with opened(broken) as file:
        ours = read(file)
        lost_messages = sum(d.messages or 0 for d in file.damage)
        more = " and a place" if any(d.messages is None for d in file.damage) else ""
    theirs, error = package_rows(broken)
    cells = (
        len(ours),
        (Counter(ours) - original).total(),
        f"{lost_messages}{more}",
        f"{len(theirs)}, {error}" if error else len(theirs),
        (Counter(theirs) - original).total(),
    )
    return tuple(map(str, cells))


def main() -> None:
    """Print the table."""
    rows: dict[str, list[tuple[str, ...]]] = {}
    for (kind, _), (broken, sound) in damage_set().items():
        rows.setdefault(kind, []).append(row(broken, sound))
    print("| damage | files | read | wrong | told as lost | `mcap` package: read | wrong |")
    print("|---|---|---|---|---|---|---|")
    for kind, kind_rows in rows.items():
        cells = [" / ".join(dict.fromkeys(column)) for column in zip(*kind_rows, strict=True)]
        print(f"| {kind} | {len(kind_rows)} | {' | '.join(cells)} |")
    files = sum(map(len, rows.values()))
    wrong = sum(int(cells[1]) for kind_rows in rows.values() for cells in kind_rows)
    print(f"\n{files} files of 3600 messages each, {wrong} wrong messages")


if __name__ == "__main__":
    main()
