"""Results of replays in memory, as a results file would give them back."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

from groundtrace.explain.reasons import matched
from groundtrace.explain.redecide import Counts
from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import load_pipeline, with_settings
from groundtrace.pipeline.engine import EventList, replay
from groundtrace.pipeline.results import Evidence, Provenance, Results, evidence_of
from groundtrace.pipeline.source import Source
from groundtrace_codecs.recording import Recording
from groundtrace_recordings import path_of

if TYPE_CHECKING:
    from pathlib import Path

    from groundtrace.evaluation.matching import StepMatch
    from groundtrace_codecs.events import Gap, Label
    from groundtrace_codecs.signals import SignalBlock


@dataclass(frozen=True)
class Walk:
    """A recording of a walker, read once."""

    name: str
    items: tuple[SignalBlock | Gap, ...]
    labels: tuple[Label, ...]
    start_ns: int
    end_ns: int

    def results(self, *settings: str) -> Results:
        """Replay it with parameters of the waist pipeline changed."""
        chain = build_pipeline(with_settings(load_pipeline("waist-peaks"), settings))
        sink = EventList()
        replay(self.items, chain, [sink])
        origin = Provenance(self.name, "ab" * 32, self.start_ns, self.end_ns, chain.recipe())
        name = "-".join(settings) or "default"
        return Results(name, origin, self.labels, None, tuple(sink.events))

    def evidence(self, *settings: str) -> Evidence:
        """The evidence of such a replay."""
        return evidence_of(self.results(*settings))

    @cache  # noqa: B019  # a handful of walks live as long as the tests
    def matching(self, *settings: str) -> StepMatch:
        """What a fresh replay finds of the truth."""
        return matched(self.evidence(*settings), 0.12)

    def counts(self, *settings: str) -> Counts:
        """Its figures."""
        return Counts.of(self.matching(*settings))


@cache
def walk_of(path: Path) -> Walk:
    """Read a recording."""
    with Recording.open(path) as opened:
        items = tuple(Source(opened))
        return Walk(path.name, items, opened.labels, opened.start_ns, opened.end_ns)


def waist_walk() -> Walk:
    """The bundled one."""
    return walk_of(path_of("waist-walk.mcap"))
