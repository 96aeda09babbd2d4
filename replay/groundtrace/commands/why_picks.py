"""What ``groundtrace why`` prints about picks."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .output import print_table
from .why_rows import first_to_last, spans
from .why_steps import print_link

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..explain.arrivals import BadPick, PickAccount, PickMoment
    from ..explain.pick_channels import ChannelPicks

HEADER = ("pick", "time [s]", "channel", "", "off [ms]", "cause", "why")


def print_pick(found: PickMoment) -> None:
    """Print a bad pick, or a moment, with the candidates about it."""
    if found.bad is not None:
        print_table(HEADER, _rows([found.bad]))
    else:
        print(f"{found.time_s:.3f} s: {len(found.chain)} candidates for picks")
    for link in found.chain:
        print_link(link)


def print_picks(found: PickAccount) -> None:
    """Print the figures, the channels with bad picks, and the bad picks."""
    print(_headline(found))
    if found.causes:
        causes = sorted(found.causes.items(), key=lambda item: -item[1])
        print("causes: " + ", ".join(f"{n} {cause}" for cause, n in causes))
    wrong = [c for c in found.channels if sum(_counts(c)[1:])]
    if wrong:
        print("\nchannels")
        header = ("channel", "right", "late", "early", "missed", "false", "median off [ms]", "")
        print_table(header, [_channel_row(c) for c in wrong])
    if found.bad:
        print("\npicks")
        print_table(HEADER, _rows(found.bad))


def _headline(found: PickAccount) -> str:
    c = found.counts
    return (
        f"{found.recording}: {found.stage}: {c.right} right to {found.tolerance_ms:g} ms, "
        f"{c.late} late, {c.early} early, {c.missed} missed, {c.false} false"
    )


def _counts(found: ChannelPicks) -> tuple[int, ...]:
    c = found.counts
    return (c.right, c.late, c.early, c.missed, c.false)


def _channel_row(found: ChannelPicks) -> tuple[str, ...]:
    whose = "its clock" if found.clock else "the picker's latency"
    note = f"by nearly the same time: {whose}" if found.clock or found.latency else ""
    return (found.channel, *map(str, _counts(found)), _number(found.median_ms), note)


def _rows(bad: Sequence[BadPick]) -> list[tuple[str, ...]]:
    """Return a row for each bad pick; those of a channel with the same reason share one."""
    groups: dict[tuple[str, str, str, str], list[BadPick]] = {}
    for b in bad:
        key = (b.channel, b.state, b.reason.cause, b.reason.text)
        groups.setdefault(key, []).append(b)
    return [
        (
            spans([b.pick for b in same]),
            first_to_last([b.time_s for b in same]),
            channel,
            state,
            _number(float(np.median([b.off_ms for b in same]))),
            cause,
            text,
        )
        for (channel, state, cause, text), same in groups.items()
    ]


def _number(value: float) -> str:
    return f"{value:+.2f}" if np.isfinite(value) else "-"


def picks_page(found: PickAccount) -> str:
    """Return the page about all picks."""
    lines = [f"# {found.recording}", "", _headline(found), ""]
    if found.bad:
        lines += ["| " + " | ".join(HEADER) + " |", "|" + "---|" * len(HEADER)]
        lines += ["| " + " | ".join(row) + " |" for row in _rows(found.bad)]
    return "\n".join(lines) + "\n"
