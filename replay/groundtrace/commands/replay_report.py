"""What ``groundtrace replay`` prints."""

from __future__ import annotations

from typing import TYPE_CHECKING

from groundtrace_codecs.events import EVENTS

from .output import print_json, print_warnings

if TYPE_CHECKING:
    from pathlib import Path

    from groundtrace_codecs.signals import Stream

    from ..engine import Tally
    from ..pipeline import Pipeline
    from ..sinks import Session


#: What is counted of a replay beside candidates, by what several of a kind are called.
COUNTED = ("picks", "steps", "fixes", "passes", "crossings", "gaps", "notes")


def counts_of(tally: Tally) -> dict[str, int]:
    """Return how many there are of what is counted."""
    named = {kind.plural: cls.__name__ for cls, kind in EVENTS.items()}
    counted = {"candidates": "CandidateBlock"} | {name: named[name] for name in COUNTED}
    return {name: tally.counts.get(cls, 0) for name, cls in counted.items()}


def report(
    session: Session,
    chain: Pipeline,
    tally: Tally,
    results: Path,
    rrd: Path | None,
    timeline: str,
    damage: int,
    *,
    json: bool,
) -> None:
    """Print what a replay did.

    Parameters
    ----------
    session
        What was replayed.
    chain
        Through what.
    tally
        What came of it.
    results
        Where it is stored.
    rrd
        The viewer's file, or None.
    timeline
        What is shown at full rate.
    damage
        Number of places that were skipped.
    json
        As one JSON document.
    """
    counts = counts_of(tally)
    warnings = tally.warnings.told(session.start_ns)
    if json:
        print_json(
            {
                "recording": session.name,
                "pipeline": chain.config.name,
                "topics": [s.topic for s in session.streams],
                "recorded_s": tally.recorded_s,
                "samples": tally.samples,
                "events": counts,
                "damage": damage,
                "results": str(results),
                "rrd": str(rrd) if rrd is not None else None,
                "rrd_bytes": rrd.stat().st_size if rrd is not None else None,
            },
            warnings,
        )
        return
    quiet_notes = counts["notes"] - sum(warned.count for warned in warnings)
    _print_report(session.streams, chain, tally, counts | {"notes": quiet_notes})
    print_warnings(warnings)
    print(f"results: {results}")
    if rrd is not None:
        size = f"{rrd.stat().st_size / 1e6:.1f} MB, {timeline}"
        print(f"timeline: {rrd}, {size} (open it with: rerun {rrd})")
    if damage:
        print(f"damage: {damage} places were skipped; see groundtrace info {session.name}")


def _print_report(
    streams: tuple[Stream, ...], chain: Pipeline, tally: Tally, counts: dict[str, int]
) -> None:
    signals = ", ".join(f"{s.topic} ({len(s.channels)} x {s.rate_hz:g} Hz)" for s in streams)
    print(f"replayed {tally.recorded_s:.1f} s of {signals} through {chain.config.name}")
    print(", ".join(f"{count} {name}" for name, count in counts.items() if count) or "no events")
