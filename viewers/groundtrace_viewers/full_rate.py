"""How much of a recording is shown at full rate, and what that weighs.

Envelopes and events of ten minutes weigh a few megabytes, every sample of 16 channels at 20 kHz a
gigabyte and more. Nobody looks at all of them: where a detector was wrong they matter.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from groundtrace_codecs.signals import NS_PER_S, SEISMIC_QUANTITIES

from .errors import ViewerError

if TYPE_CHECKING:
    from groundtrace.sinks import Session
    from groundtrace_codecs.signals import Stream

#: Above this rate the overview shows an envelope, and samples only where they are asked for.
FULL_RATE_HZ = 500.0
#: What can be asked for, besides a span.
MODES = ("none", "misses", "events", "all")
#: How much is shown before and after a miss or an event [ns].
REACH_NS = NS_PER_S // 2
#: A sample takes so much of a file [bytes], and so much as recorded by a converter of 16 bits.
SHOWN_BYTES, RAW_BYTES = 4.8, 2.0
#: Where every sample fits into this [bytes], every sample is shown instead of those around misses.
SMALL_BYTES = 32e6
#: Otherwise samples around misses take at most this much of the raw ones, or the above.
MOST_OF_RAW = 0.25
#: Everything else takes about this much for a second of a fast channel, and of any recording.
REST_BYTES, LEAST_REST_BYTES = 1_400.0, 4_000.0
#: Layout, pages and what is logged once [bytes].
ONCE_BYTES = 350e3
#: A sample of a slow stream with its share of filtered signals and magnitudes [bytes].
SLOW_BYTES = 25.0


@dataclass(frozen=True, slots=True)
class FullRate:
    """What was asked for.

    Attributes
    ----------
    mode
        One of ``none``, ``misses``, ``events``, ``all`` and ``span``.
    span_s
        First and last time of a span, since the first sample [s].
    """

    mode: str
    span_s: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def parse(cls, text: str) -> FullRate:
        """Read what stands on a command line.

        Raises
        ------
        ViewerError
            Where it is neither a mode nor a span.
        """
        if text in MODES:
            return cls(text)
        first, _, last = text.partition("-")
        try:
            span_s = float(first), float(last)
        except ValueError:
            span_s = (0.0, 0.0)
        if not 0.0 <= span_s[0] < span_s[1] < math.inf:
            expected = ", ".join(MODES)
            raise ViewerError(
                f"--full-rate: expected {expected} or FROM-TO in seconds, found {text!r}"
            )
        return cls("span", span_s)


@dataclass(frozen=True, slots=True)
class Plan:
    """What of one session is shown at full rate.

    Attributes
    ----------
    mode
        As asked for; ``all`` where every sample is as good as what was asked for.
    shown_ns
        First and last time that is shown at all [ns].
    span_ns
        Every sample of this half-open span is shown [ns].
    truth
        Whether it is known what was missed; else steps stand for misses.
    second_bytes
        What a second at full rate takes.
    budget_bytes
        What all close-ups may take.
    rest_bytes
        What everything else takes, about.
    """

    mode: str
    shown_ns: tuple[int, int]
    span_ns: tuple[int, int]
    truth: bool
    second_bytes: float
    budget_bytes: float
    rest_bytes: float

    @property
    def duration_ns(self) -> int:
        """How long what is shown lasts [ns]."""
        return self.shown_ns[1] - self.shown_ns[0]

    @property
    def whole(self) -> bool:
        """Whether every sample is shown."""
        return self.mode == "all"

    @property
    def close_ups(self) -> bool:
        """Whether samples are shown around moments."""
        return self.mode in ("misses", "events")

    @property
    def subject(self) -> str:
        """What close-ups show."""
        return "misses and false steps" if self.mode == "misses" and self.truth else "events"

    @property
    def shown(self) -> str:
        """Of which samples there is more than envelopes, without close-ups."""
        span_s = [(t - self.shown_ns[0]) / NS_PER_S for t in self.span_ns]
        part = f"every sample of {span_s[0]:.1f} to {span_s[1]:.1f} s"
        return {"none": "no samples but envelopes", "all": "every sample"}.get(self.mode, part)

    def words(self) -> str:
        """Return what the timeline will weigh, before it is written."""
        span_bytes = self.second_bytes * (self.span_ns[1] - self.span_ns[0]) / NS_PER_S
        size = f"timeline: about {_megabytes(self.rest_bytes + span_bytes)}"
        if not self.second_bytes:
            return size
        if not self.close_ups:
            return f"{size}, {self.shown}"
        each = _megabytes(2 * REACH_NS / NS_PER_S * self.second_bytes)
        instead = "" if self.truth or self.mode == "events" else " (no truth says what was missed)"
        most = f", at most {_megabytes(self.budget_bytes)} of these"
        return f"{size}, and {each} at full rate around each of {self.subject}{instead}{most}"


def planned(asked: FullRate, session: Session) -> Plan:
    """Return what of a session is shown at full rate.

    Parameters
    ----------
    asked
        What was asked for.
    session
        Its shown part counts.
    """
    start_ns, end_ns = session.shown_ns or (session.start_ns, session.end_ns)
    duration_s = (end_ns - start_ns) / NS_PER_S
    channels = sum(_fast_channels(stream) for stream in session.streams)
    rate = sum(_fast_channels(stream) * stream.rate_hz for stream in session.streams)
    slow = sum(len(s.channels) * s.rate_hz for s in session.streams if s.rate_hz <= FULL_RATE_HZ)
    rest = ONCE_BYTES + duration_s * (LEAST_REST_BYTES + REST_BYTES * channels + SLOW_BYTES * slow)
    whole = duration_s * rate * SHOWN_BYTES
    mode = "all" if asked.mode == "misses" and whole <= SMALL_BYTES else asked.mode
    budget = max(SMALL_BYTES, MOST_OF_RAW * RAW_BYTES * duration_s * rate)
    span_ns = (start_ns, start_ns)
    if mode == "all":
        span_ns = (start_ns, end_ns + 1)
    elif mode == "span":
        first, last = (session.start_ns + round(s * NS_PER_S) for s in asked.span_s)
        span_ns = (max(first, start_ns), max(first, start_ns, min(last, end_ns + 1)))
    truth = any(label.kind == "step" for label in session.labels)
    budget = whole if mode == "events" else min(budget, whole)
    return Plan(mode, (start_ns, end_ns), span_ns, truth, rate * SHOWN_BYTES, budget, rest)


def enveloped(stream: Stream, quantity: str) -> bool:
    """Whether a quantity of a stream has an envelope: its samples are shown on demand."""
    return stream.rate_hz > FULL_RATE_HZ and quantity in SEISMIC_QUANTITIES


def _fast_channels(stream: Stream) -> int:
    return sum(enveloped(stream, channel.quantity) for channel in stream.channels)


def _megabytes(size: float) -> str:
    """Return a size as text."""
    return f"{size / 1e6:.2g} MB" if size < 10e6 else f"{size / 1e6:.0f} MB"
