"""Six causes are planted in simulated recordings; ``why`` names each of them."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace.cli.main import main
from groundtrace.simulate.gait import WalkOptions
from groundtrace.simulate.room import simulate_room
from groundtrace.simulate.room_plan import RoomOptions
from groundtrace.simulate.walk import simulate_walk
from groundtrace_codecs.events import Label
from groundtrace_codecs.signals import NS_PER_S, SignalBlock
from groundtrace_codecs.writer import write_recording

if TYPE_CHECKING:
    from pathlib import Path

    import pytest
    from numpy.typing import NDArray

    from groundtrace.simulate.recording import Simulation

RATE = 20_000
STEP = round(0.48 * RATE)  # a step and its coda, but not the next step
LEAD = round(0.02 * RATE)


@dataclass
class Planting:
    """A simulated room whose samples are changed step by step."""

    simulation: Simulation
    samples: NDArray[np.float64]
    noise: NDArray[np.float64]
    labels: list[Label]

    @classmethod
    def room(cls) -> Planting:
        simulation = simulate_room(RoomOptions(channels=4, steps=20))
        samples = np.concatenate([b.samples for b in simulation.sources[0][2]]).astype(float)
        quiet = samples[1000 : 1000 + STEP].copy()  # before the first step
        return cls(simulation, samples, quiet, list(simulation.labels))

    def step(self, number: int) -> Label:
        return [x for x in self.simulation.labels if x.kind == "step"][number - 1]

    def begin(self, number: int) -> int:
        start = self.simulation.sources[0][2]
        first = next(iter(start)).start_ns
        return round((self.step(number).time_ns - first) * RATE / NS_PER_S) - LEAD

    def weaken(self, number: int, kept: float, channels: list[int]) -> None:
        a = self.begin(number)
        part = self.samples[a : a + STEP, channels]
        self.samples[a : a + STEP, channels] = self.noise[:, channels] + kept * part

    def kill(self, number: int, channel: int) -> None:
        a = self.begin(number)
        self.samples[a : a + STEP, channel] = 0

    def repeat(self, number: int, after_s: float) -> None:
        a, shift = self.begin(number), round(after_s * RATE)
        part = self.samples[a : a + 2000].copy()
        self.samples[a + shift : a + shift + 2000] += part
        time_ns = self.step(number).time_ns + round(after_s * NS_PER_S)
        self.labels.append(Label(time_ns, "step"))

    def heave(self, number: int) -> None:
        """Put a slow movement, far below the picker's band, in the place of a step."""
        self.weaken(number, 0.0, [0, 1, 2, 3])
        a, n = self.begin(number) + LEAD, round(0.4 * RATE)
        self.samples[a : a + n] += 800 * np.sin(np.pi * np.arange(n) / n)[:, None] ** 2

    def write(self, path: Path) -> None:
        stream, sample_format, blocks = self.simulation.sources[0]
        start_ns = next(iter(blocks)).start_ns
        whole = np.clip(np.rint(self.samples), -32768, 32767).astype(np.int16)
        block = SignalBlock(stream, start_ns, 0, whole)
        geometry = self.simulation.geometry
        write_recording(
            path, [(stream, sample_format, [block])], geometry=geometry, labels=self.labels
        )


def why(path: Path, capsys: pytest.CaptureFixture[str], *replay: str) -> Any:
    """Replay a recording and return the account of its results."""
    results = path.with_suffix(".results.mcap")
    main(["replay", str(path), "--no-viewer", "--out", str(results), *replay])
    capsys.readouterr()
    main(["why", str(results), "--json"])
    return json.loads(capsys.readouterr().out)


def test_five_causes_planted_in_a_room_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    room = Planting.room()
    for channel, kept in enumerate(
        (0.02, 0.05, 0.05, 0.04)
    ):  # above the floor, as far off as it is
        room.weaken(3, kept, [channel])
    room.weaken(6, 0.0, [2, 3])
    room.kill(9, 2)
    room.repeat(12, 0.168)
    room.heave(15)
    room.write(tmp_path / "room.mcap")

    account = why(tmp_path / "room.mcap", capsys)

    by_time = {round(m["time_s"], 2): m["reason"] for m in account["missed"]}

    def reason(number: int, later_s: float = 0.0) -> Any:
        first = room.simulation.sources[0][2]
        start_ns = next(iter(first)).start_ns
        at = (room.step(number).time_ns - start_ns) / NS_PER_S + later_s
        return by_time[round(at, 2)]

    assert reason(3)["cause"] == "threshold"
    assert "ratio" in reason(3)["text"]
    assert reason(6)["cause"] == "coincidence"
    assert "2 of 4 channels" in reason(6)["text"]
    assert reason(9)["cause"] == "dead"
    assert "G3 is dead" in reason(9)["text"]
    assert reason(12, 0.168)["cause"] == "refractory"
    assert reason(15)["cause"] == "filter"
    assert "attenuated by the filter" in reason(15)["text"]


def test_the_closed_walking_gate_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    simulation = simulate_walk(WalkOptions(duration_s=60.0))
    steps = sorted(x.time_ns for x in simulation.labels if x.kind == "step")
    stream, sample_format, blocks = simulation.sources[0]
    whole = np.concatenate([b.values for b in blocks])
    start_ns = next(iter(simulation.sources[0][2])).start_ns
    times = start_ns + np.arange(len(whole)) * 10_000_000
    rest = whole[50:250].mean(axis=0)  # stands still
    lonely = steps[10]
    around = (np.abs(times - lonely) < 2e9) & ~((times > lonely - 2e8) & (times < lonely + 3e8))
    whole[around] = rest
    labels = [x for x in simulation.labels if x.kind != "step" or abs(x.time_ns - lonely) > 2e9]
    labels.append(Label(lonely, "step"))
    scaled = whole / stream.scales
    write_recording(
        tmp_path / "walk.mcap",
        [(stream, sample_format, [SignalBlock(stream, start_ns, 0, scaled)])],
        labels=labels,
    )

    account = why(
        tmp_path / "walk.mcap", capsys, "--pipeline", "waist-peaks", "--set", "steps.activity=0.9"
    )

    lonely_s = (lonely - start_ns) / NS_PER_S
    reason = next(m["reason"] for m in account["missed"] if abs(m["time_s"] - lonely_s) < 0.01)
    assert reason["cause"] == "walking"
    assert reason["gate"] == "activity"
