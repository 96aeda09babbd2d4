"""Azimuths of dead reckoning in the table of steps."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import pytest

from groundtrace.inertial.pdr import PedestrianDeadReckoning
from groundtrace.inertial.steps import ReckoningParameters
from groundtrace.pipeline.gates import Candidates, GateState, decided_block, gate_specs
from groundtrace_codecs.events import StageSpec
from groundtrace_viewers.rerun.walk import AzimuthView

if TYPE_CHECKING:
    from groundtrace_codecs.events import CandidateBlock
    from groundtrace_viewers.rerun.context import ViewContext


class Sent:
    """Keeps what is sent to a timeline."""

    def __init__(self) -> None:
        self.rows: list[tuple[str, list[int]]] = []
        self.columns: list[Any] = []

    def send(self, path: str, times_ns: Any, columns: Any) -> None:
        self.rows.append((path, np.asarray(times_ns).tolist()))
        self.columns += list(columns)


def block(time_ns: int, cadence_hz: float, emits: str = "track") -> CandidateBlock:
    """One step of a reckoner, with its cadence."""
    worker = PedestrianDeadReckoning(ReckoningParameters())
    gates = gate_specs(worker.gates, worker.parameters)
    spec = StageSpec("track", "x", "/imu", ("walker",), worker.columns, gates, (), emits)
    values = {"cadence": cadence_hz, "speed": 1.0, "length": 0.7, "azimuth": 12.345}
    row = np.array([[values.get(c.name, 0.0) for c in worker.columns]], np.float32)
    found = Candidates(np.array([time_ns], np.int64), np.zeros(1, np.int32), row)
    return decided_block(spec, found, worker, worker.parameters, GateState())[0]


def test_steps_that_were_taken_get_their_azimuth_in_the_table() -> None:
    pytest.importorskip("rerun")
    sent = Sent()
    log = AzimuthView(cast("ViewContext", SimpleNamespace(timeline=sent)))
    for time_ns, cadence_hz in ((1, 1.8), (2, 9.0), (3, 1.9)):
        log.candidates(block(time_ns, cadence_hz))
    log.flush()
    assert sent.rows == [("/table/steps", [1, 3])]
    names = " ".join(str(column.component_descriptor()) for column in sent.columns)
    assert all(title in names for title in ("azimuth_deg", "length_m", "mounting_deg"))
    log.flush()
    assert len(sent.rows) == 1


def test_other_stages_have_no_azimuths() -> None:
    sent = Sent()
    log = AzimuthView(cast("ViewContext", SimpleNamespace(timeline=sent)))
    log.candidates(block(1, 1.8, "step"))
    log.flush()
    assert not sent.rows
