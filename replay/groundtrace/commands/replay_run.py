"""Running a replay from a command: progress, stopping, going on."""

from __future__ import annotations

from typing import TYPE_CHECKING

from groundtrace_codecs.signals import NS_PER_S

from ..clock import Clock
from ..engine import ReplayLoop
from ..results import ResultsSink
from ..resumable import Keeper, stopping
from .output import progress

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..engine import Tally
    from ..pipeline import Pipeline
    from ..resumable import Left
    from ..sinks import Session, Sink
    from ..source import Source


def kept_run(
    keeper: Keeper,
    before: Left | None,
    sinks: Sequence[Sink],
    session: Session,
    rate: float,
    *,
    quiet: bool,
) -> Tally:
    """Replay, or go on from what was left, until the end or until the user asks to stop."""
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
) -> Tally:
    """Replay into sinks, from opening to closing them."""
    # what filters is not imported before there is something to filter
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
            tally = run.through(noted(source, None if keeper is None else keeper.watches))
        if keeper is not None:
            keeper.end()
        return tally
    except BaseException:
        for sink in sinks:
            if isinstance(sink, ResultsSink):
                sink.abandon()
        raise
    finally:
        for sink in sinks:
            sink.close()
