"""Simulated rooms with faults planted in samples or geometry, for the tests of ``why``."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace.cli.main import main
from groundtrace.simulate.room import simulate_room
from groundtrace.simulate.room_plan import RoomOptions
from groundtrace_codecs.signals import SignalBlock
from groundtrace_codecs.writer import write_recording

if TYPE_CHECKING:
    from pathlib import Path

    import pytest
    from numpy.typing import NDArray

    from groundtrace.simulate.recording import Simulation

RATE = 20_000
STEPS = 14
#: A step and its coda, but not the next step.
STEP = round(0.4 * RATE)
#: Places of onsets as they were picked: no array method that mends a wrong pick by the others.
ONSETS = """
name = "room-onsets"
description = "Places of onsets."
application = "room"
[[stage]]
name = "picks"
use = "toa-cv"
[[stage]]
name = "steps"
use = "coincidence"
[[stage]]
use = "so-tdoa"
[[stage]]
use = "hyperbolic"
[[stage]]
use = "power-law"
"""


@cache
def simulated(channels: int) -> tuple[Simulation, list[SignalBlock]]:
    """Return a simulated room and its samples; the same room is simulated once."""
    simulation = simulate_room(RoomOptions(channels=channels, steps=STEPS))
    return simulation, list(simulation.sources[0][2])


class Room:
    """A simulated room whose samples and geometry are changed.

    Attributes
    ----------
    samples
        Shape (n, channels), as recorded.
    """

    samples: NDArray[np.int16]

    def __init__(self, channels: int = 9) -> None:
        simulation, blocks = simulated(channels)
        self.stream, self.sample_format, _ = simulation.sources[0]
        self.start_ns = blocks[0].start_ns
        self.samples = np.concatenate([block.samples for block in blocks])
        self.geometry = simulation.geometry
        self.labels = simulation.labels

    def kill(self, channel: int) -> None:
        """Let a channel stand still."""
        self.samples[:, channel] = 0

    def delay(self, channel: int, delay_s: float) -> None:
        """Let a channel come later all the time, as a clock that is late makes it."""
        n = round(delay_s * RATE)
        self.samples[n:, channel] = self.samples[:-n, channel].copy()

    def delay_step(self, channel: int, number: int, delay_s: float) -> None:
        """Let a channel come later in one step."""
        n, a = round(delay_s * RATE), self._begin(number)
        part = self.samples[a - n : a + STEP - n, channel].copy()
        self.samples[a : a + STEP, channel] = part

    def set_clock(self, channel: int, ahead_s: float) -> None:
        """Write into the geometry how far the clock of a sensor is ahead."""
        sensors = list(self.geometry.sensors)
        sensors[channel] = replace(sensors[channel], clock_offset_s=ahead_s)
        self.geometry = replace(self.geometry, sensors=tuple(sensors))

    def move(self, channel: int, by_m: tuple[float, float]) -> None:
        """Write a wrong place of a sensor into the geometry."""
        sensors = list(self.geometry.sensors)
        old = sensors[channel]
        sensors[channel] = replace(old, x=old.x + by_m[0], y=old.y + by_m[1])
        self.geometry = replace(self.geometry, sensors=tuple(sensors))

    def knock(self, channel: int, number: int, after_s: float, counts: int) -> None:
        """Add a short knock to a channel, so long after a step."""
        a = self._begin(number) + round((0.02 + after_s) * RATE)
        self.samples[a : a + 10, channel] += np.int16(counts)

    def _begin(self, number: int) -> int:
        steps = sorted(x.time_ns for x in self.labels if x.kind == "step")
        return round((steps[number - 1] - self.start_ns) / 1e9 * RATE) - round(0.02 * RATE)

    def results(self, folder: Path, *settings: str, truth: bool = True, pipeline: str = "") -> Path:
        """Write the recording, replay it and return its results."""
        block = SignalBlock(self.stream, self.start_ns, 0, self.samples)
        labels = self.labels if truth else ()
        path, out = folder / "room.mcap", folder / "room.results.mcap"
        source = [(self.stream, self.sample_format, [block])]
        write_recording(path, source, geometry=self.geometry, labels=labels)
        options = [part for setting in settings for part in ("--set", setting)]
        if pipeline:
            (folder / "pipeline.toml").write_text(pipeline, "utf-8")
            options += ["--pipeline", str(folder / "pipeline.toml")]
        main(["replay", str(path), "--no-viewer", "--out", str(out), *options])
        return out


def why(results: Path, capsys: pytest.CaptureFixture[str], *options: object) -> Any:
    """Return the JSON that ``why`` prints."""
    capsys.readouterr()
    main(["why", str(results), "--json", *(str(option) for option in options)])
    return json.loads(capsys.readouterr().out)
