"""Simulated roads through pipelines, for tests."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import load_pipeline, with_settings
from groundtrace.pipeline.conformance import rechunked
from groundtrace.simulate.vehicle import simulate_vehicle
from groundtrace_codecs.events import CandidateBlock, LikelihoodSurface, StageSpec, TraceBlock

if TYPE_CHECKING:
    from collections.abc import Sequence

    from groundtrace.simulate.recording import Simulation
    from groundtrace.simulate.road import VehicleOptions
    from groundtrace_codecs.events import Event
    from groundtrace_codecs.signals import SignalBlock

START_NS = 1_767_603_600_000_000_000


@cache
def road(options: VehicleOptions) -> tuple[Simulation, tuple[SignalBlock, ...]]:
    """Return a simulation and its blocks."""
    simulation = simulate_vehicle(options)
    return simulation, tuple(b for _, _, blocks in simulation.sources for b in blocks)


def replayed(
    options: VehicleOptions,
    pipeline: str,
    settings: Sequence[str] = (),
    samples: int = 200,
    stages: int | None = None,
) -> list[Event]:
    """Return the events of a pipeline, or its first stages, in blocks of so many samples.

    Blocks are those of a second that are simulated, or smaller. The same is replayed once.
    """
    return list(_replayed(options, pipeline, tuple(settings), samples, stages))


@cache
def _replayed(
    options: VehicleOptions,
    pipeline: str,
    settings: tuple[str, ...],
    samples: int,
    stages: int | None,
) -> tuple[Event, ...]:
    simulation, blocks = road(options)
    config = with_settings(load_pipeline(pipeline), settings)
    config = replace(config, stage=config.stage[:stages])
    chain = build_pipeline(config, simulation.geometry, ())
    events: list[Event] = []
    for block in rechunked(blocks, samples):
        events += chain.process(block)
    return (*events, *chain.flush())


def told(events: Sequence[Event]) -> list[tuple[object, ...]]:
    """Return events as rows that compare, numbers to 9 digits, in the order of time and stage."""
    rows = [row for event in events if not isinstance(event, StageSpec) for row in _rows(event)]
    return sorted(rows, key=repr)


def _rows(event: Event) -> list[tuple[object, ...]]:
    if isinstance(event, CandidateBlock | TraceBlock):
        name = type(event).__name__
        values = event.value.reshape(len(event), -1)
        return [
            (name, event.spec.stage, int(t), *(f"{v:.4g}" for v in row))
            for t, row in zip(event.time_ns, values, strict=True)
        ]
    if isinstance(event, LikelihoodSurface):
        levels = np.frombuffer(event.levels, np.uint8)
        return [("surface", event.time_ns, int(levels.argmax()))]
    fields = [getattr(event, name) for name in event.__slots__]
    return [(type(event).__name__, *(f"{v:.5g}" if isinstance(v, float) else v for v in fields))]
