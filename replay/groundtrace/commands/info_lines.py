"""Lines of ``groundtrace info``: streams, guessed placements, gaps."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..api.inspection import GapInfo, StreamInfo


def print_guesses(streams: Sequence[StreamInfo]) -> None:
    """Print where each sensor may be worn."""
    for stream in streams:
        guess = stream.placement_guess
        if guess is not None:
            but = f"; stated: {stream.placement}, which is taken" if guess.contradicts else ""
            print(f"placement of {stream.topic}, a guess: {guess.text}{but}")


def stream_row(s: StreamInfo) -> tuple[str, ...]:
    """Return the cells of one stream."""
    kinds: dict[str, list[str]] = {}
    for channel in s.channels:
        kinds.setdefault(f"{channel['quantity']} [{channel['unit']}]", []).append(channel["name"])
    text = "; ".join(f"{_names(names)}: {kind}" for kind, names in kinds.items())
    rate = f"{s.rate_hz:g}" + (" irregular" if s.irregular else "")
    return (s.topic, "-" if s.samples is None else str(s.samples), rate, s.placement, text)


def _names(names: Sequence[str]) -> str:
    return ", ".join(names) if len(names) <= 4 else f"{names[0]} ... {names[-1]} ({len(names)})"


def _cut(steps: int) -> str:
    return f", cuts or swallows {steps} true step{'s' * (steps > 1)}" if steps else ""


def print_gaps(gaps: Sequence[GapInfo]) -> None:
    """Print unbridged gaps one by one, the bridged ones as counts."""
    for gap in [g for g in gaps if not g.bridged][:20]:
        print(
            f"gap: {gap.topic} {gap.start_s:.3f} to {gap.end_s:.3f} s, {gap.reason}, "
            f"{gap.lost} samples{_cut(gap.steps)}"
        )
    more = sum(not g.bridged for g in gaps) - 20
    if more > 0:
        print(f"gap: and {more} more")
    bridged = Counter((g.topic, g.reason) for g in gaps if g.bridged)
    for (topic, reason), count in bridged.items():
        print(f"bridged: {topic} {count} times {reason}")
