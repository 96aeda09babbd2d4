"""Arrivals where the amplitude is over a level: the smallest detector that is of use."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from groundtrace.pipeline.gates import Candidates, Level, Refractory
from groundtrace.pipeline.parameters import gate, measured
from groundtrace.pipeline.stage import Context, Input, Stage
from groundtrace_codecs import Pick, Quantity, SignalBlock


@dataclass(frozen=True, slots=True)
class Thresholds:
    """Parameters of :class:`ThresholdPicker`."""

    floor: Annotated[float, measured("m/s", "Lowest peak kept as a candidate.", ge=0)] = 1e-5
    level: Annotated[float, gate("m/s", "Lowest peak that is an arrival.", ge=0)] = 2e-5
    refractory_s: Annotated[float, gate("s", "Least time between two arrivals.", ge=0)] = 0.25


class ThresholdPicker(Stage):
    """An arrival is a peak of the amplitude that is high enough and comes in time."""

    Parameters = Thresholds
    takes = (Input(SignalBlock, frozenset({"ground_velocity"})),)
    gives = (Pick,)
    columns = (Quantity("amplitude", "m/s"),)
    gates = (Level("amplitude", "m/s", "level"), Refractory())

    def __init__(self, parameters: Thresholds) -> None:
        self.floor = parameters.floor

    def start(self, context: Context) -> tuple[str, ...]:
        """Begin a run; every channel is picked on its own."""
        self.state = (np.empty(0, np.int64), np.empty((0, len(context.stream.channels))))
        return tuple(channel.name for channel in context.stream.channels)

    def process(self, block: SignalBlock) -> Iterator[Candidates]:
        """Find the local maxima; whether a sample is one, the next sample tells."""
        times = np.concatenate([self.state[0], block.sample_times()])
        height = np.concatenate([self.state[1], np.abs(block.values)])
        self.state = (times[-2:], height[-2:])  # the next block goes on from these
        before, here, after = height[:-2], height[1:-1], height[2:]
        row, channel = np.nonzero((here > before) & (here >= after) & (here >= self.floor))
        value = here[row, channel, None].astype(np.float32)
        yield Candidates(times[1:-1][row], channel.astype(np.int32), value)
