"""Words for values that stand still."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .finding import Finding, Tally, percent, times
from .full_scales import clipped_effect, near_scale

if TYPE_CHECKING:
    from collections.abc import Iterator

    from groundtrace_codecs.signals import Channel, Stream

    from .held import Line


def held_findings(stream: Stream, column: int, line: Line, heard: int) -> Iterator[Finding]:
    """Yield what stands still in one channel."""
    channel = stream.channels[column]
    if line.constant.events:
        yield _constant(stream, channel, line, heard)
    rails = list(line.rails.found())
    if rails:
        yield _clipped(stream, channel, rails, heard)
    if line.dropouts.events:
        yield _dropouts(stream, channel, line.dropouts, heard)


def _finding(
    stream: Stream, channel: Channel, kind: str, tally: Tally, heard: int, *text: str
) -> Finding:
    share = tally.samples / heard
    span = tally.start_ns, tally.end_ns
    return Finding(stream.topic, channel.name, kind, *span, tally.events, share, *text)


def _constant(stream: Stream, channel: Channel, line: Line, heard: int) -> Finding:
    tally = line.constant
    at = " and ".join(level(channel, value) for value in line.values)
    if tally.samples == heard:
        what, remedy = f"constant at {at} throughout", "look at its cable, or leave it out"
        return _finding(
            stream, channel, "constant", tally, heard, what, "nothing is found on it", remedy
        )
    if line.late_ns is not None and tally.events == 1:
        length_s = tally.samples / stream.rate_hz
        return _finding(
            stream,
            channel,
            "late",
            tally,
            heard,
            f"appears late: constant at {at} for the first {length_s:.3f} s",
            "until then it is as if it were not there",
            "look at when it was switched on",
        )
    part = percent(tally.samples / heard)
    return _finding(
        stream,
        channel,
        "constant",
        tally,
        heard,
        f"constant at {at} {times(tally.events)} for 1 s or longer, {part} of the samples",
        *_still(channel),
    )


def _still(channel: Channel) -> tuple[str, str]:
    """Return effect and remedy of a channel that stands still now and then."""
    if channel.quantity == "magnetic_field":
        return "a compass goes on with old values there", "let the phone calibrate before walking"
    return "nothing is found there", "look at its cable and at packets lost"


def _clipped(
    stream: Stream, channel: Channel, rails: list[tuple[float, Tally]], heard: int
) -> Finding:
    both = Tally(
        sum(t.events for _, t in rails),
        sum(t.samples for _, t in rails),
        min(t.start_ns for _, t in rails),
        max(t.end_ns for _, t in rails),
    )
    at = " and ".join(level(channel, value) for value, _ in rails)
    part = percent(both.samples / heard)
    scale = near_scale(channel, max(abs(value) for value, _ in rails) * channel.scale)
    return _finding(
        stream,
        channel,
        "clipped",
        both,
        heard,
        f"clipped at {at}{scale} {times(both.events)}, {part} of the samples",
        *clipped_effect(channel),
    )


def _dropouts(stream: Stream, channel: Channel, tally: Tally, heard: int) -> Finding:
    longest = f"{tally.samples / stream.rate_hz / tally.events * 1e3:.3g} ms each on average"
    return _finding(
        stream,
        channel,
        "dropouts",
        tally,
        heard,
        f"stands still inside its signal {times(tally.events)}, {longest}",
        "what lies there is missed, and its edges may look like onsets",
        "look at the connection and at packets lost",
    )


def level(channel: Channel, value: float) -> str:
    """Return a stored value in the channel's unit, for people."""
    return f"{value * channel.scale:.4g} {channel.unit}"
