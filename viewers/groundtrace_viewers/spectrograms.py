"""Which signals of a session have spectrograms."""

from __future__ import annotations

from typing import TYPE_CHECKING

from groundtrace_codecs.signals import NS_PER_S

from .fine_spectrogram import chosen
from .spectrogram import Spectrogram

if TYPE_CHECKING:
    from collections.abc import Sequence

    from groundtrace.sinks import Session

    from .full_rate import Plan
    from .timeline import Timeline


def spectrograms(
    timeline: Timeline, session: Session, plan: Plan, channels: Sequence[str]
) -> tuple[str, list[Spectrogram]]:
    """Return the topic with spectrograms, and those; empty where nothing fits.

    Parameters
    ----------
    timeline
        Where to.
    session
        What is replayed.
    plan
        How much of it.
    channels
        Whose spectrograms are wanted; empty takes the first seismic channel's.
    """
    fitting = [s for s in session.streams if Spectrogram.fits(s)]
    stream = next((s for s in fitting if chosen(s, channels)), next(iter(fitting), None))
    if stream is None:
        return "", []
    columns: list[int | None] = [*chosen(stream, channels)] or [None]
    duration_s = plan.duration_ns / NS_PER_S
    return stream.topic, [Spectrogram(timeline, stream, duration_s, c) for c in columns]
