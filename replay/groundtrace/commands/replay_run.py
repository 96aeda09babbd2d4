"""Running a replay from a command: progress, and being stopped."""

from __future__ import annotations

import itertools
import signal
import threading
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

from groundtrace_codecs.signals import NS_PER_S

from ..engine import ReplayLoop
from .output import progress

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from groundtrace_codecs.events import Note

    from ..clock import Clock
    from ..engine import Tally
    from ..pipeline import Pipeline
    from ..sinks import Session, Sink
    from ..source import Source


@contextmanager
def terminable() -> Iterator[None]:
    """End as with Ctrl-C where the system asks for it, so that what was begun is cleared away."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


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
    """Replay into sinks, from opening to closing them.

    A replay that is stopped leaves no output under its name.

    Parameters
    ----------
    source, chain, sinks, session
        What is replayed, through what, and where to.
    clock
        Paces the replay; None means as fast as possible.
    quiet
        Show no progress.
    looked_at
        Topics whose placement is known, so that none is guessed.
    first
        What is to be said of the recording before anything else.
    """
    # what filters is not imported before there is something to filter
    from ..health.imu import judged
    from ..placement_watch import noted

    first_ns, last_ns = session.shown_ns or (session.start_ns, session.end_ns)
    for sink in sinks:
        sink.open(session)
    length_s, done = (last_ns - first_ns) / NS_PER_S, False
    try:
        with terminable(), progress(length_s, "replaying", quiet=quiet) as show:
            run = ReplayLoop(
                chain,
                sinks,
                clock=clock,
                progress=lambda t_ns: show((t_ns - first_ns) / NS_PER_S),
            )
            placed = noted(source, dict.fromkeys(looked_at))
            tally = run.through(itertools.chain(first, judged(placed, source.streams)))
        done = True
        return tally
    finally:
        with ExitStack() as closing:  # each is closed, whatever comes of the others
            for sink in reversed(sinks):
                closing.callback(sink.close if done else getattr(sink, "abandon", sink.close))
