"""Fixes, track points, headings and disturbances in a results file."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import pytest

from groundtrace_codecs.errors import SchemaError
from groundtrace_codecs.events import (
    EVENTS,
    Bearing,
    Disagreement,
    Disturbance,
    Event,
    Fix,
    Heading,
    TrackPoint,
)
from groundtrace_codecs.mcap.reader import McapFile
from groundtrace_codecs.schemas.event_messages import decoder_of, events_of
from groundtrace_codecs.schemas.protobuf import message_class
from groundtrace_codecs.writer import RecordingWriter

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

START_NS = 1_700_000_000_000_000_000
SPREAD = (0.04, -0.01, 0.09)
ESTIMATES: list[Event] = [
    Fix(START_NS, 1.25, -3.5, SPREAD, 2.0, "so-tdoa", 9, "locate"),
    TrackPoint(START_NS + 1, 3, 1.0, 2.0, 0.5, -0.25, SPREAD, "track", 1.5),
    Heading(START_NS + 2, -3.1, 0.05, "compass"),
    Disturbance(START_NS + 3, START_NS + 2 * 10**9, 17.5, "compass"),
    Bearing(START_NS + 4, "S1", 1.5, 0.02, 0.9, True, "bearings"),
    Disagreement(START_NS + 5, 1.25, 4.0, "so-tdoa, power-law", "apart"),
]


def write(path: Path, events: Sequence[Event]) -> list[Event]:
    with RecordingWriter(path) as writer:
        for event in events:
            writer.add_event(event)
    with McapFile.open(path) as file:
        return list(events_of(file))


@pytest.mark.parametrize("event", ESTIMATES)
def test_an_estimate_comes_back_as_it_was(tmp_path: Path, event: Event) -> None:
    assert write(tmp_path / "results.mcap", [event]) == [event]


def test_what_is_unknown_stays_unknown(tmp_path: Path) -> None:
    nan = math.nan
    (point,) = write(
        tmp_path / "results.mcap",
        [TrackPoint(START_NS, 0, 0.0, 0.0, nan, nan, (nan, nan, nan), "track")],
    )
    assert isinstance(point, TrackPoint)
    assert all(map(math.isnan, (point.vx_mps, point.nis, *point.covariance)))


def test_fixes_and_disturbances_have_a_line_in_the_log_and_curves_have_none(tmp_path: Path) -> None:
    from foxglove_schemas_protobuf.Log_pb2 import Log

    path = tmp_path / "results.mcap"
    write(path, ESTIMATES)
    with McapFile.open(path) as file:
        topics = {c.topic: i for i, c in file.channels.items()}
        lines = [Log.FromString(bytes(m.data)) for m in file.messages({topics["/groundtrace/log"]})]
    assert [(line.name, line.message) for line in lines] == [
        ("locate", "fix x=1.250 m y=-3.500 m so-tdoa picks=9"),
        ("bearings", "bearing S1 85.9 degrees"),
        ("apart", "so-tdoa, power-law are 1.25 m apart, 4 sigma"),
        ("compass", "disturbed for 2 s value=17.5"),
    ]
    assert set(topics) == {"/groundtrace/log", *(EVENTS[type(e)].topic for e in ESTIMATES)}


@pytest.mark.parametrize("cls", [Fix, TrackPoint])
def test_a_covariance_has_three_numbers(cls: type) -> None:
    data = message_class(cls.__name__)(covariance=[1.0, 2.0]).SerializeToString()
    with pytest.raises(SchemaError, match="here: covariance: expected 3 numbers, found 2"):
        decoder_of(cls)("here", data)
