"""What ``groundtrace merge`` says: the clocks, and what is in the merged file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from groundtrace_codecs.signals import NS_PER_S

from .output import print_json, print_table, say

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from groundtrace_codecs.merge_record import MergedClock
    from groundtrace_codecs.merging import Merged

    from ..alignment import Alignment
    from .merge_clocks import Found


@dataclass(frozen=True, slots=True)
class OtherShift:
    """The second best way to lay a file over the first one."""

    from_best_s: float
    matched: int
    of: int
    scatter_s: float
    margin: float
    needed: float


@dataclass(frozen=True, slots=True)
class ClockReport:
    """The clock of one file, as JSON."""

    file: str
    name: str
    how: str
    ahead_s: float
    drift_ppm: float
    about_ns: int
    matched: int
    of: int
    scatter_s: float | None
    ahead_sigma_s: float | None
    drift_sigma_ppm: float | None
    ambiguous: bool
    second: OtherShift | None


@dataclass(frozen=True, slots=True)
class MergeReport:
    """What a merged file holds, as JSON."""

    path: str
    bytes: int
    clocks: list[ClockReport]
    messages: dict[str, int]
    conflicts: list[str]
    unmoved: list[str]
    damage: list[str]


def report(
    out: Path, sources: Sequence[Path], found: Sequence[Found], merged: Merged, *, json: bool
) -> None:
    """Say what was merged, with which clocks, and what of it is not as it was."""
    result = MergeReport(
        str(out),
        out.stat().st_size,
        [_clock(f) for f in found],
        merged.messages,
        list(merged.conflicts),
        list(merged.unmoved),
        [damage.reason for damage in merged.damage],
    )
    for line in merged.conflicts:
        say(f"note: {line}")
    for topic in merged.unmoved:
        say(f"note: {topic}: its messages hold no times that are known; their log times were moved")
    for damage in merged.damage:
        count = "some" if damage.messages is None else damage.messages
        say(f"warning: damage, {count} messages lost: {damage.reason}")
    if json:
        print_json(result)
        return
    files = f"{len(sources)} files" if len(sources) != 1 else sources[0].name
    print(f"wrote {out}: {result.bytes / 1e6:.2f} MB out of {files}")
    for each in found[1:] if len(found) > 1 else found:
        for line in clock_lines(each.record, found[0].record.file, each.alignment):
            print(line)
    print_table(("topic", "messages"), [(t, str(n)) for t, n in merged.messages.items()])


def _clock(found: Found) -> ClockReport:
    record, alignment = found.record, found.alignment
    second = None
    if alignment is not None and alignment.second is not None:
        other = alignment.second
        second = OtherShift(
            other.ahead_s - alignment.best.ahead_s,
            other.matched,
            other.possible,
            other.sigma_s,
            alignment.margin,
            alignment.needed,
        )
    return ClockReport(
        record.file,
        record.name,
        record.how,
        record.ahead_ns / NS_PER_S,
        record.drift_ppm,
        record.about_ns,
        record.matched,
        record.events,
        alignment.best.sigma_s if alignment is not None else None,
        record.sigma_s,
        record.drift_sigma_ppm,
        alignment is not None and alignment.ambiguous,
        second,
    )


def clock_lines(record: MergedClock, first: str, alignment: Alignment | None) -> list[str]:
    """Return in words how a file's clock stands to the first one's, and how sure that is."""
    lines = [record.line(first)]
    if alignment is None:
        return lines
    best, other = alignment.best, alignment.second
    lines.append(
        f"  {best.matched} of {best.possible} {record.how} agree, scatter "
        f"{best.sigma_s * 1e3:.1f} ms"
    )
    if not best.drift_fitted:
        told = f"these {record.how} tell it to {best.drift_sigma_ppm:.0f} ppm only"
        lines.append(f"  drift: taken as 0, {told}")
    if other is not None:
        lines.append(
            f"  second best: {other.ahead_s - best.ahead_s:+.3f} s from it, {other.matched} of "
            f"{other.possible} agree, scatter {other.sigma_s * 1e3:.1f} ms (margin "
            f"{alignment.margin:.0f}, needed {alignment.needed:.0f})"
        )
    return lines
