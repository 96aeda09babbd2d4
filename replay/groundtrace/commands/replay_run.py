"""Running a replay from a command: progress, stopping, going on."""

from __future__ import annotations

import itertools
from contextlib import ExitStack
from typing import TYPE_CHECKING

from groundtrace_codecs.signals import NS_PER_S

from ..clock import Clock
from ..engine import ReplayLoop
from ..resumable import Keeper, stopping
from .output import progress

if TYPE_CHECKING:
    from collections.abc import Sequence

    from groundtrace_codecs.events import Note

    from ..engine import Tally
    from ..pipeline import Pipeline
    from ..resumable import Left
    from ..sinks import Session, Sink
    from ..source import Source
    from ..suitability import Prepared


def kept_run(
    keeper: Keeper,
    before: Left | None,
    sinks: Sequence[Sink],
    session: Session,
    rate: float,
    ready: Prepared,
    *,
    quiet: bool,
) -> Tally:
    """Replay, or go on from what was left, until the end or until the user asks to stop.

    What is to be said of the recording comes first, unless it was said before.
    """
    keeper.watches.update(dict.fromkeys(ready.looked_at))
    first = ready.notes if before is None else ()
    clock = Clock(rate) if rate else None
    if clock is not None:
        keeper.stop.hurry = lambda: setattr(clock, "rate", 0.0)
    if before is not None:
        keeper.tally = before.checkpoint.tally
    keeper.source.rest = keeper.rest
    with stopping(keeper.stop):
        return run_into(
            keeper.source,
            keeper.chain,
            sinks,
            session,
            clock,
            quiet=quiet,
            keeper=keeper,
            before=before,
            first=first,
        )


def run_into(
    source: Source,
    chain: Pipeline,
    sinks: Sequence[Sink],
    session: Session,
    clock: Clock | None = None,
    *,
    quiet: bool,
    keeper: Keeper | None = None,
    before: Left | None = None,
    first: Sequence[Note] = (),
) -> Tally:
    """Replay into sinks, from opening to closing them."""
    # what filters is not imported before there is something to filter
    from ..health.imu import judged
    from ..placement_watch import noted

    first_ns, last_ns = session.shown_ns or (session.start_ns, session.end_ns)
    for sink in sinks:
        sink.open(session)
    try:
        if keeper is not None:
            keeper.begin(before)
        with progress((last_ns - first_ns) / NS_PER_S, "replaying", quiet=quiet) as show:
            run = ReplayLoop(
                chain,
                sinks,
                clock=clock,
                progress=lambda t_ns: show((t_ns - first_ns) / NS_PER_S),
                tally=None if keeper is None else keeper.tally,
            )
            if keeper is not None:
                keeper.settle = run.settle
            placed = noted(source, None if keeper is None else keeper.watches)
            kept = None if keeper is None else keeper.sensors
            tally = run.through(itertools.chain(first, judged(placed, source.streams, kept)))
        if keeper is not None:
            keeper.end()
        return tally
    except BaseException:
        for sink in sinks:
            abandon = getattr(sink, "abandon", None)
            if abandon is not None:
                abandon()
        raise
    finally:
        with ExitStack() as closing:  # each is closed, whatever comes of the others
            for sink in reversed(sinks):
                closing.callback(sink.close)
