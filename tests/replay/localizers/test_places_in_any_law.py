"""No localizer is worse than the middle of the room, whatever law the waves obey."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import load_pipeline
from groundtrace.pipeline.engine import replay
from groundtrace.pipeline.source import Source
from groundtrace.simulate.recording import write
from groundtrace.simulate.room import simulate_room
from groundtrace.simulate.room_plan import RoomOptions
from groundtrace_codecs.events import Fix
from groundtrace_codecs.recording import Recording

if TYPE_CHECKING:
    from pathlib import Path


class Fixes:
    """A sink that keeps fixes."""

    def __init__(self) -> None:
        self.found: list[Fix] = []

    def write(self, item: object) -> None:
        if isinstance(item, Fix):
            self.found.append(item)


@pytest.mark.parametrize("law", ["plate", "f0.3", "f0", "f-0.3", "layered"])
def test_no_localizer_is_worse_than_the_middle_of_the_room(law: str, tmp_path: Path) -> None:
    options = RoomOptions(seed=11, channels=6, steps=12, impacts=True, wave_law=law, rate_hz=8000.0)
    write(simulate_room(replace(options, gain_spread=0.2, walls=0.3)), tmp_path / "room.mcap")
    config = load_pipeline("room-footsteps")
    kept = Fixes()
    with Recording.open(tmp_path / "room.mcap") as opened:
        replay(Source(opened), build_pipeline(config, opened.geometry), [kept])
        truth = [x for x in opened.labels if x.kind == "impact"]
        middle = np.mean(opened.geometry.outline, axis=0)
    times = np.array([x.time_ns for x in truth])
    places = np.array([(x.x_m, x.y_m) for x in truth])
    rival = np.median(np.hypot(*(places - middle).T))
    errors: dict[str, list[float]] = {}
    for fix in kept.found:
        true = places[int(np.abs(times - fix.time_ns).argmin())]
        errors.setdefault(fix.stage, []).append(float(np.hypot(*(true - (fix.x_m, fix.y_m)))))
    assert len(errors) == 6
    assert {
        name: float(np.median(off)) for name, off in errors.items() if np.median(off) > rival
    } == {}
