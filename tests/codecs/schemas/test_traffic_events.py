"""What is said of vehicles, in a results file."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest

from groundtrace_codecs.errors import SchemaError
from groundtrace_codecs.events import (
    EVENTS,
    Event,
    LikelihoodSurface,
    LineCrossing,
    Pass,
    Presence,
    quantised,
)
from groundtrace_codecs.mcap.reader import McapFile
from groundtrace_codecs.schemas.event_messages import decoder_of, events_of
from groundtrace_codecs.schemas.protobuf import message_class
from groundtrace_codecs.writer import RecordingWriter

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

START_NS = 1_700_000_000_000_000_000
TRAFFIC: list[Event] = [
    Presence(START_NS, START_NS + 5 * 10**9, "S1", "/seismic", "presence", 17.5),
    Pass(START_NS + 1, 0.05, "S1", 3, "forward", 10.5, 0.2, 0.6, 21.0, "passes"),
    LineCrossing(START_NS + 2, 0.1, 1, "A1-A3", 3.0, 0.0, 0.4, 9.5, 0.3, 1.3, "course"),
    LikelihoodSurface(START_NS + 3, -5.0, 2.0, 0.5, 3, 2, -20.0, -1.0, b"\0\1\2\3\4\xff", "grid"),
]


def write(path: Path, events: Sequence[Event]) -> list[Event]:
    with RecordingWriter(path) as writer:
        for event in events:
            writer.add_event(event)
    with McapFile.open(path) as file:
        return list(events_of(file))


@pytest.mark.parametrize("event", TRAFFIC)
def test_what_is_said_of_a_vehicle_comes_back_as_it_was(tmp_path: Path, event: Event) -> None:
    assert write(tmp_path / "results.mcap", [event]) == [event]


def test_a_pass_at_one_station_has_no_speed(tmp_path: Path) -> None:
    alone = Pass(START_NS, 0.1, "S2", 0, "", math.nan, math.nan, 0.5, 9.0, "passes")
    (found,) = write(tmp_path / "results.mcap", [alone])
    assert isinstance(found, Pass)
    assert math.isnan(found.speed_mps)
    assert (found.vehicle, found.direction) == (0, "")


def test_all_but_surfaces_have_a_line_in_the_log(tmp_path: Path) -> None:
    from foxglove_schemas_protobuf.Log_pb2 import Log

    path = tmp_path / "results.mcap"
    write(path, TRAFFIC)
    with McapFile.open(path) as file:
        topics = {c.topic: i for i, c in file.channels.items()}
        lines = [Log.FromString(bytes(m.data)) for m in file.messages({topics["/groundtrace/log"]})]
    assert sorted((line.name, line.message) for line in lines) == [
        ("course", "vehicle 1 crosses A1-A3 at 3.00, 0.00"),
        ("passes", "vehicle 3 forward passes S1 speed=10.5 m/s"),
        ("presence", "vehicle heard at S1 for 5 s value=17.5"),
    ]
    assert set(topics) == {"/groundtrace/log", *(EVENTS[type(e)].topic for e in TRAFFIC)}


def test_a_surface_is_true_to_half_a_level_and_cut_below() -> None:
    x, y = np.array([0.0, 0.5, 1.0]), np.array([2.0, 2.5])
    values = np.array([[-3.0, -7.25, -500.0], [-4.0, -12.0, -22.9]])
    found = quantised(START_NS, x, y, values, "grid", depth=20)
    assert (found.columns, found.rows, found.step_m) == (3, 2, 0.5)
    half = 20 / 255 / 2
    assert found.values() == pytest.approx(np.maximum(values, -23), abs=half + 1e-9)


def test_an_even_surface_is_told_too() -> None:
    even = quantised(START_NS, np.arange(2.0), np.arange(2.0), np.full((2, 2), 5.0), "grid")
    assert even.values() == pytest.approx(np.full((2, 2), 5.0))


def test_a_surface_of_other_size_is_refused() -> None:
    message = message_class("LikelihoodSurface")(columns=2, rows=2, levels=b"abc")
    with pytest.raises(SchemaError, match="levels: expected 4 bytes, found 3"):
        decoder_of(LikelihoodSurface)("a surface", message.SerializeToString())
