"""The detector of vehicles: in which cycles does a channel hear one, and not footsteps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np

from groundtrace_codecs.events import Presence, Quantity
from groundtrace_codecs.signals import SEISMIC_QUANTITIES, SignalBlock

from ..detector import Frames, Measured
from ..detectors.filters import planar
from ..gates import Candidates, Level
from ..parameters import gate, measured
from ..presence_spans import Spans
from ..stage import Context, Input, Stage
from .cycles import CyclePower, CyclePowers
from .floors import NoiseFloor
from .lasting import Lasting
from .presence import PresenceFeatures

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from groundtrace_codecs.events import CandidateBlock

    from ..stage import Output
    from .presence import Features

    Array = NDArray[np.float64]

_COLUMNS = 8
#: Power over the floor is told within this [dB]: a channel that is off has neither.
_RANGE_DB = 100.0


@dataclass(frozen=True, slots=True)
class PresenceParameters:
    """Parameters of :class:`VehiclePresence`."""

    low_hz: Annotated[float, measured("Hz", "Lower edge of the band.", gt=0)] = 5.0
    high_hz: Annotated[float, measured("Hz", "Upper edge of the band.", gt=0)] = 40.0
    cycle_s: Annotated[float, measured("s", "Length of a working cycle.", ge=0.1, le=10)] = 0.5
    window_s: Annotated[float, measured("s", "Looked at for the shape.", ge=3, le=30)] = 4.0
    floor_s: Annotated[float, measured("s", "Looked back on for the noise.", ge=10)] = 120.0
    over_floor: Annotated[float, gate("dB", "Lowest power over the noise.")] = 5.0
    impulsiveness: Annotated[
        float, gate("1", "Highest excess kurtosis of the levelled samples.")
    ] = 1.5
    cadence: Annotated[
        float, gate("1", "Highest part of the envelope at a walking cadence.", ge=0)
    ] = 0.5
    flatness: Annotated[float, gate("1", "Highest spectral flatness; noise is near 1.")] = 0.92
    centroid: Annotated[float, gate("Hz", "Lowest mean frequency; wind is lower.", ge=0)] = 8.0
    lasting_s: Annotated[float, gate("s", "Shortest time for which all that is so.", ge=0)] = 1.0


@dataclass(slots=True)
class _State:
    cycles: CyclePower
    floor: NoiseFloor
    features: PresenceFeatures


class VehiclePresence(Stage):
    """A vehicle is power that lasts, without the impulses and the cadence of footsteps.

    Every channel and cycle is a candidate. Power and floor are kept beside what the gates look at:
    the stages after this one work on them.
    """

    Parameters = PresenceParameters
    takes = (Input(SignalBlock, SEISMIC_QUANTITIES),)
    gives = (Presence,)
    columns = (
        Quantity("over_floor", "dB"),
        Quantity("power", "unit^2"),
        Quantity("floor", "unit^2"),
        Quantity("floor_sigma", "unit^2"),
        Quantity("impulsiveness", "1"),
        Quantity("cadence", "1"),
        Quantity("flatness", "1"),
        Quantity("centroid", "Hz"),
    )
    trace = (Quantity("over_floor", "dB"),)
    gates = (
        Level("over_floor", "dB", "over_floor"),
        Level("impulsiveness", "1", "impulsiveness", at_least=False),
        Level("cadence", "1", "cadence", at_least=False),
        Level("flatness", "1", "flatness", at_least=False),
        Level("centroid", "Hz", "centroid"),
        Lasting(),
    )

    def __init__(self, parameters: PresenceParameters) -> None:
        self.parameters = parameters
        self.spans = Spans()

    def start(self, context: Context) -> tuple[str, ...]:
        """Begin a run; every channel is heard on its own."""
        stream = context.stream
        p, rate, n = self.parameters, stream.rate_hz, len(stream.channels)
        self.state = _State(
            CyclePower(rate, n, p.cycle_s, p.low_hz, p.high_hz),
            NoiseFloor(round(p.floor_s / p.cycle_s)),
            PresenceFeatures(rate, n, p.cycle_s, p.window_s, p.low_hz, p.high_hz),
        )
        return tuple(c.name for c in stream.channels)

    def process(self, block: SignalBlock) -> Measured:
        """Return the cycles that the block completes."""
        times, x = block.sample_times(), planar(block)
        return self._measured(self.state.cycles.add(times, x), self.state.features.add(times, x))

    def flush(self) -> Iterator[Output]:
        """Yield the last cycle, if there is half of it; its shape stays unknown. End all spans."""
        yield from self._measured(self.state.cycles.finish(), None)
        yield from self.spans.finish()

    def decided(self, block: CandidateBlock) -> Iterator[Presence]:
        """Yield the spans that have ended."""
        return self.spans.take(block)

    def _measured(self, found: CyclePowers, shapes: Features | None) -> Measured:
        channels, cycles = found.power.shape
        if not cycles:
            empty = np.empty((0, channels, 1), np.float32)
            return Measured(Candidates.empty(_COLUMNS), Frames(np.empty(0, np.int64), empty))
        floors = self.state.floor(found.power, found.freedom)
        floor = floors.power
        columns = np.full((_COLUMNS, channels, cycles), np.nan)
        columns[:4] = over_floor_db(found.power, floor), found.power, floor, floors.sigma
        half_ns = self.state.cycles.cycle_ns // 2
        if shapes is not None:
            _, mine, theirs = np.intersect1d(
                found.time_ns + half_ns, shapes.time_ns, return_indices=True
            )
            told = shapes.impulsiveness, shapes.cadence, shapes.flatness, shapes.centroid_hz
            columns[4:, :, mine] = np.array(told)[..., theirs]
        values = columns.transpose(2, 1, 0).astype(np.float32)
        candidates = Candidates(
            np.repeat(found.time_ns, channels),
            np.tile(np.arange(channels, dtype=np.int32), cycles),
            values.reshape(-1, _COLUMNS),
        )
        return Measured(candidates, Frames(found.time_ns - half_ns, values[..., :1]))


def over_floor_db(power: Array, floor: Array) -> Array:
    """Return power over the floor [dB], any shape; 0 where there is no floor."""
    known = floor > 0
    ratio = np.divide(power, floor, out=np.ones_like(power), where=known)
    least = 10 ** (-_RANGE_DB / 10)
    return np.asarray(np.clip(10 * np.log10(np.maximum(ratio, least)), -_RANGE_DB, _RANGE_DB))
