"""Sinks: where a replay's signals and events go."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from groundtrace_codecs.annotations import Annotation
    from groundtrace_codecs.events import Event
    from groundtrace_codecs.geometry import Geometry
    from groundtrace_codecs.labels import Label
    from groundtrace_codecs.signals import SignalBlock, Stream


@dataclass(frozen=True, slots=True)
class Session:
    """What a replay is about, told to every sink before the first item.

    Attributes
    ----------
    name
        File name of the recording.
    application
        Kind of recording, which chooses a viewer's layout: ``room``, ``walker``, ``shots``, ...
    start_ns, end_ns
        First and last sample of the recording [ns].
    streams
        What will be replayed.
    geometry
        Where the sensors stand, or None.
    labels
        The recording's own truth.
    pipeline
        The pipeline's recipe, for people.
    shown_ns
        The part of the recording that is shown, first and last time [ns]; None for all of it.
    annotations
        What people marked, beside the recording or inside it.
    """

    name: str
    application: str
    start_ns: int
    end_ns: int
    streams: tuple[Stream, ...]
    geometry: Geometry | None
    labels: tuple[Label, ...]
    pipeline: str
    shown_ns: tuple[int, int] | None = None
    annotations: tuple[Annotation, ...] = ()


class Sink(Protocol):
    """Takes what a replay produces, in time order."""

    def open(self, session: Session) -> None:
        """Begin a replay."""

    def write(self, item: SignalBlock | Event) -> None:
        """Take one block or event."""

    def close(self) -> None:
        """End the replay; everything taken is safe afterwards."""
