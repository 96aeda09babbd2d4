"""The stage that runs a localizer: the arrivals of each step become a place."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace_codecs.events import CandidateBlock, Gap, Note, Pick, StageSpec, StepEvent
from groundtrace_codecs.geometry import Geometry
from groundtrace_codecs.signals import NS_PER_S

from .gates import Candidates, Carry, Reach, decided_block, gate_specs, never_passed
from .lengths import in_length_unit
from .localizers.api import Site
from .localizers.location import LEAST_PICKS
from .stage import PluginStage

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Event
    from groundtrace_codecs.signals import SignalBlock

    from .localizers.api import Localizer
    from .localizers.location import Location

#: Arrivals older than this before the newest are forgotten: a step is announced well before [ns].
KEEP_NS = 10 * NS_PER_S


@dataclass(slots=True)
class _Run:
    """A localizer at work on the arrivals of one topic.

    ``lacking`` says why it cannot work there; it is said once, with the first step.
    """

    worker: Localizer
    spec: StageSpec
    channels: dict[str, int]
    offsets_s: NDArray[np.float64]
    lacking: str
    told: bool = False
    carry: Carry = field(default_factory=Carry)
    picks: deque[Pick] = field(default_factory=deque)


def placed_channels(
    channels: Sequence[str], geometry: Geometry
) -> tuple[dict[str, int], NDArray[np.float64]]:
    """Return the row of each channel whose place is known, and the places, shape (n, 2) [m].

    Channels of several axes at one place are one sensor: that of z, which the waves of a step move
    most, or of the first axis where there is no z.
    """
    known = {s.channel: s for s in geometry.sensors}
    sensors = [known[name] for name in dict.fromkeys(channels) if name in known]
    axis: dict[tuple[float, float, float], str] = {}
    for s in sensors:
        place = s.x, s.y, s.z
        axis[place] = "z" if s.axis == "z" else axis.get(place, s.axis)
    placed = [s for s in sensors if axis[s.x, s.y, s.z] == s.axis]
    positions = np.array([(s.x, s.y) for s in placed], np.float64).reshape(-1, 2)
    return {s.channel: index for index, s in enumerate(placed)}, positions


def first_arrivals(
    picks: Iterable[Pick],
    channels: Mapping[str, int],
    step_ns: int,
    window_s: float,
    offsets_s: NDArray[np.float64] | None = None,
) -> NDArray[np.float64]:
    """Return the first arrival at each sensor within the window of a step [s], else NaN.

    Parameters
    ----------
    picks
        In any order; those of channels that have no place are left out.
    channels
        The row of each channel that has one.
    step_ns, window_s
        The step, and how long after it arrivals belong to it, by the clocks as they are.
    offsets_s
        Shape (n,): how far the clock of each channel is ahead [s]; subtracted from its arrival.
    """
    times = np.full(len(channels), np.nan)
    for pick in picks:
        since = (pick.time_ns - step_ns) / NS_PER_S
        index = channels.get(pick.channel)
        if index is not None and 0 <= since <= window_s and not times[index] <= since:
            times[index] = since
    return times if offsets_s is None else times - offsets_s


def place_candidate(time_ns: int, location: Location) -> Candidates:
    """Return a place as the candidate that a localizer's gates decide on."""
    sigma = float(np.sqrt(np.trace(location.covariance) / 2))
    value = [location.picks, location.residual, location.x, location.y, sigma]
    return Candidates(
        np.array([time_ns], np.int64), np.zeros(1, np.int32), np.array([value], np.float32)
    )


class LocalizerStage(PluginStage["Localizer"]):
    """Runs one localizer on every step, with the arrivals of the last picking stage before it.

    Parameters
    ----------
    name, plugin, kind, parameters, topics
        As those of :class:`groundtrace.stage.DetectorStage`.
    picking, stepping
        The stages whose picks and steps it takes.
    geometry
        Where the sensors are; None where unknown.

    Notes
    -----
    A step is announced once its arrivals are complete, so it is located at once. Where a site
    lacks what the localizer needs, a note says so and no places come of it.
    """

    def __init__(
        self,
        name: str,
        plugin: str,
        kind: type[Localizer],
        parameters: Any,
        topics: Sequence[str] = (),
        *,
        picking: str,
        stepping: str,
        geometry: Geometry | None = None,
    ) -> None:
        super().__init__(name, plugin, kind, parameters, topics)
        self.picking = picking
        self.stepping = stepping
        self.geometry = geometry or Geometry()
        self._runs: dict[str, _Run] = {}

    def process(self, item: SignalBlock | Event) -> Iterator[Event]:
        """Begin at the stage that picks, gather its picks, and locate steps."""
        match item:
            case StageSpec(stage=stage) if stage == self.picking:
                yield from self._begin(item)
            case Pick(stage=stage, topic=topic) if stage == self.picking and topic in self._runs:
                self._remember(self._runs[topic], item)
            case StepEvent(stage=stage, topic=topic) if stage == self.stepping:
                if topic in self._runs:
                    yield from self._locate(self._runs[topic], item.time_ns)
            case Gap(reason="clock step", bridged=False, topic=topic) if topic in self._runs:
                self._runs[topic].picks.clear()
                self._runs[topic].carry = Carry()

    def flush(self) -> Iterator[Event]:
        """Yield nothing: no step is held back."""
        yield from ()

    def _begin(self, source: StageSpec) -> Iterator[Event]:
        if not self.allowed(source.topic):
            return
        worker = self.kind(self.parameters)
        places, positions = placed_channels(source.channels, self.geometry)
        gates = gate_specs(worker.gates, self.parameters)
        spec = StageSpec(
            self.name, self.plugin, source.topic, ("all",), worker.columns, gates, (), worker.emits
        )
        spec = in_length_unit(spec, self.geometry)
        lacking = "places of three or more sensors"
        if len(np.unique(positions, axis=0)) >= LEAST_PICKS:
            outline = np.array(self.geometry.outline, np.float64)
            medium = self.geometry.medium
            room = outline if len(outline) else None
            lacking = worker.start(Site(positions, room, medium, self.geometry.length_unit))
        ahead = self.geometry.clock_offsets(places)
        self._runs[source.topic] = _Run(worker, spec, places, ahead, lacking)
        if not lacking:
            yield spec

    def _remember(self, run: _Run, pick: Pick) -> None:
        if pick.channel in run.channels and not run.lacking:
            run.picks.append(pick)
            while run.picks[0].time_ns < pick.time_ns - KEEP_NS:
                run.picks.popleft()

    def _locate(self, run: _Run, time_ns: int) -> Iterator[Event]:
        if run.lacking:
            if not run.told:
                run.told = True
                text = f"{run.spec.topic}: no places: expected a geometry with {run.lacking}"
                yield Note(time_ns, f"{text}, found none", "WARN", self.name)
            return
        if not run.told:
            run.told = True
            reach = {"picks": Reach(len(run.channels), "the picked channels that have a place")}
            for text in never_passed(run.spec, reach):
                yield Note(time_ns, text, "WARN", self.name)
        while run.picks and run.picks[0].time_ns < time_ns:
            run.picks.popleft()
        arrivals = first_arrivals(
            run.picks, run.channels, time_ns, self.parameters.window_s, run.offsets_s
        )
        location = run.worker.locate(arrivals)
        block = self._decided(run, time_ns, location)
        yield block
        if block.accepted[0]:
            yield location.fix(time_ns, self.plugin, self.name)

    def _decided(self, run: _Run, time_ns: int, location: Location) -> CandidateBlock:
        found = place_candidate(time_ns, location)
        block, run.carry = decided_block(run.spec, found, run.worker, self.parameters, run.carry)
        return block
