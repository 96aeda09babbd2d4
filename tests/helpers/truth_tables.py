"""Labels written as truth tables."""

from __future__ import annotations

import csv
import io
from decimal import Decimal
from typing import TYPE_CHECKING

from groundtrace_codecs.signals import NS_PER_S
from groundtrace_codecs.truth import COLUMNS

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from groundtrace_codecs.events import Label


def write_truth_csv(path: Path, labels: Iterable[Label], start_ns: int) -> None:
    """Write labels, their times in seconds since the recording's first sample at ``start_ns``."""
    names = [name for name in COLUMNS if name not in ("time_ns", "end_ns")]
    table = io.StringIO(newline="")
    writer = csv.writer(table)
    writer.writerow(names)
    writer.writerows([_cell(label, name, start_ns) for name in names] for label in labels)
    path.write_bytes(table.getvalue().encode(errors="surrogatepass"))


def _cell(label: Label, name: str, start_ns: int) -> str:
    if name in ("time_s", "end_s"):
        time_ns = label.time_ns if name == "time_s" else label.end_ns
        return "" if time_ns is None else f"{Decimal(time_ns - start_ns) / NS_PER_S:f}"
    value = getattr(label, name)
    return "" if value is None else str(value)
