"""What a stage is told when it starts, for tests that ask a stage itself."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from groundtrace.pipeline.stage import Context
from groundtrace_codecs.events import StageSpec
from groundtrace_codecs.signals import Stream

if TYPE_CHECKING:
    from collections.abc import Iterable

    from groundtrace.pipeline.gates import Candidates


def context_of(*given: Stream | StageSpec, **known: Any) -> Context:
    """The context of a stage of a stream, or of what stages before it state."""
    stream = next((g for g in given if isinstance(g, Stream)), Stream("", (), 0.0))
    sources = {g.stage: g for g in given if isinstance(g, StageSpec)}
    topic = given[0].topic if given else ""
    return Context("stage", "plugin", topic, stream, sources, **known)


def rows_in(parts: Iterable[Candidates]) -> int:
    """How many candidates some parts have."""
    return sum(map(len, parts))
