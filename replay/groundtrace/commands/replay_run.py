"""Running a replay from a command: its progress is shown, and it can be stopped."""

from __future__ import annotations

from typing import TYPE_CHECKING

from groundtrace_codecs.signals import NS_PER_S

from ..api.session import run_through, terminable
from .output import progress

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from groundtrace_codecs.events import Note

    from ..clock import Clock
    from ..engine import Tally
    from ..pipeline import Pipeline
    from ..sinks import Session, Sink
    from ..source import Source


def run_into(
    source: Source,
    chain: Pipeline,
    sinks: Sequence[Sink],
    session: Session,
    clock: Clock | None = None,
    *,
    quiet: bool,
    looked_at: Iterable[str] = (),
    first: Sequence[Note] = (),
) -> Tally:
    """Replay as :func:`~groundtrace.api.session.run_through`; with ``quiet`` nothing is shown."""
    first_ns, last_ns = session.shown_ns or (session.start_ns, session.end_ns)
    length_s = (last_ns - first_ns) / NS_PER_S
    with terminable(), progress(length_s, "replaying", quiet=quiet) as show:
        return run_through(
            source,
            chain,
            sinks,
            session,
            clock=clock,
            progress=lambda part: show(part * length_s),
            looked_at=looked_at,
            first=first,
        )
