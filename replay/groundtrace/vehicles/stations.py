"""Working cycles: the powers of all stations in one cycle, and the base of stages that use them."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace_codecs.events import EVENTS, CandidateBlock, Presence
from groundtrace_codecs.signals import NS_PER_S

from ..pipeline.gates import Candidates
from ..pipeline.stage import CannotStart, Context, Input, Stage

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Event
    from groundtrace_codecs.geometry import Stations

    from ..pipeline.stage import Output

    Array = NDArray[np.float64]

#: Stations no further off the line through them than this part of their length are in a row. At a
#: distance d beside the row the power at one that is e off differs from that of the mirror image by
#: 3 e / d (n = 1.5), less than the third by which a power errs where e < d / 9; d is taken to be a
#: quarter of the length. Source: definition.
_ROW = 1 / 36


def line_through(places: Array) -> tuple[Array, Array]:
    """Return the middle of places, shape (n, 2), and the direction they lie along, (2,) each."""
    centre = places.mean(axis=0)
    along = np.linalg.svd(places - centre)[2][0]
    return np.asarray(centre), np.asarray(along)


def row_doubt(names: Sequence[str], places: Array) -> str:
    """Return what to doubt of places by powers of stations in a row; empty where they are not."""
    centre, along = line_through(places)
    off = places - centre
    across = off @ np.array([-along[1], along[0]])
    if np.abs(across).max() > _ROW * np.ptp(off @ along):
        return ""
    return f"{', '.join(names)} stand in a row: which side of it a place is on, powers do not tell"


@dataclass(frozen=True, slots=True, eq=False)
class StationPowers:
    """One working cycle at all stations.

    Attributes
    ----------
    time_ns
        Its middle.
    powers, floors, floor_sigmas
        Shape (n,): sums over the channels of a station, noise included, of the noise, and the
        standard deviation of that [unit^2]; NaN where nothing was recorded.
    steady
        Shape (n,): of the running medians of powers [unit^2].
    present
        Shape (n,): whether any channel of the station hears a vehicle.
    """

    time_ns: int
    powers: Array
    floors: Array
    floor_sigmas: Array
    steady: Array
    present: NDArray[np.bool_]


def candidates_of(rows: list[tuple[int, int, list[float]]], columns: int) -> Candidates:
    """Return rows of (time [ns], channel, values) as candidates, in the order of the first two."""
    if not rows:
        return Candidates.empty(columns)
    return Candidates(
        np.array([row[0] for row in rows], np.int64),
        np.array([row[1] for row in rows], np.int32),
        np.array([row[2] for row in rows], np.float32),
    )


#: A channel that is silent for longer is not waited for [ns]. Chosen by judgement: no recorder is
#: as late, and a replay goes on without a dead one.
_PATIENCE_NS = 30 * NS_PER_S


class StationJoin:
    """Puts the cycles of several recorders together, in the order of time.

    A cycle is complete when every channel of the site has told it or a later one, or when the
    newest is half a minute later.

    Parameters
    ----------
    site
        The stations.
    """

    def __init__(self, site: Stations) -> None:
        self.site = site
        self._latest = dict.fromkeys(site.of_channel, -(2**63))
        self._waiting: dict[int, tuple[NDArray[np.float64], NDArray[np.bool_]]] = {}
        self._past: int | None = None

    def add(self, block: CandidateBlock) -> Iterator[StationPowers]:
        """Take the cycles of one topic; yield those that are complete."""
        names = [c.name for c in block.spec.columns]
        columns = [names.index(name) for name in ("power", "floor", "floor_sigma", "steady")]
        stations = [self.site.of_channel.get(name) for name in block.spec.channels]
        for row in range(len(block)):
            channel = int(block.channel[row])
            station = stations[channel]
            if station is None:
                continue
            time_ns = int(block.time_ns[row])
            self._latest[block.spec.channels[channel]] = time_ns
            if self._past is None or time_ns > self._past:
                values = block.value[row, columns].astype(np.float64)
                values[2] **= 2  # errors of the floors of a station's channels are independent
                self._put(time_ns, station, values, present=bool(block.accepted[row]))
        newest = max(self._latest.values())
        yield from self._until(max(min(self._latest.values()), newest - _PATIENCE_NS))

    def flush(self) -> Iterator[StationPowers]:
        """Yield all that waited; times may then begin anew."""
        yield from self._until(2**63)
        self._past = None
        self._latest = dict.fromkeys(self._latest, -(2**63))

    def _put(
        self, time_ns: int, station: int, values: NDArray[np.float64], *, present: bool
    ) -> None:
        if time_ns not in self._waiting:
            n = len(self.site.names)
            self._waiting[time_ns] = np.full((4, n), np.nan), np.zeros(n, np.bool_)
        sums, detected = self._waiting[time_ns]
        sums[:, station] = np.where(np.isnan(sums[:, station]), 0, sums[:, station]) + values
        detected[station] |= present

    def _until(self, last_ns: int) -> Iterator[StationPowers]:
        for time_ns in sorted(self._waiting):
            if time_ns <= last_ns:
                sums, present = self._waiting.pop(time_ns)
                self._past = time_ns
                power, floor, variance, steady = sums
                yield StationPowers(time_ns, power, floor, np.sqrt(variance), steady, present)


class CycleStage(Stage):
    """Works on the cycles of the stage that hears vehicles, of all topics together.

    What is found is told of the first topic heard. Where the clock steps, the run of cycles ends.

    Notes
    -----
    ``least_stations`` says how many stations at places it needs.
    """

    takes = (Input(CandidateBlock, of=Presence, anywhere=True),)
    scope = "recording"
    ends_at = "clock step"
    site_lengths = True
    least_stations: int
    #: What a stage that tracks takes, in words.
    needs = "vehicles at stations"

    def __init__(self, parameters: Any) -> None:
        self.parameters = parameters
        self._join: StationJoin | None = None
        self._channels: tuple[str, ...] = ()

    @abstractmethod
    def begin(self, site: Stations, stage: str) -> tuple[str, ...]:
        """Begin; return the names of the candidates' channels."""

    @abstractmethod
    def take(self, cycle: StationPowers) -> Candidates:
        """Take the next cycle; return what is to be decided."""

    @abstractmethod
    def finish(self) -> Candidates:
        """End of a run of cycles; return what is to be decided of it."""

    @abstractmethod
    def follow(self, accepted: NDArray[np.bool_]) -> Iterable[Event]:
        """Yield the events of the candidates just returned, by whether they were accepted."""

    def stations_of(self, context: Context) -> Stations:
        """Return the stations: those that have places."""
        return context.geometry.stations()

    def start(self, context: Context) -> tuple[str, ...]:
        """Begin where there are stations enough; what was learnt before a clock step stays."""
        if self._join is None:
            site = self.stations_of(context)
            if len(site.names) < self.least_stations:
                raise CannotStart(
                    f"no {EVENTS[self.gives[0]].name}: expected a geometry with places of "
                    f"{self.least_stations} or more stations, found {len(site.names) or 'none'}"
                )
            self._join = StationJoin(site)
            self._channels = self.begin(site, context.stage)
        return self._channels

    def process(self, block: CandidateBlock) -> Iterator[Output]:
        """Take the cycles of one topic, with those of the others."""
        assert self._join is not None  # it was started
        for cycle in self._join.add(block):
            yield self.take(cycle)

    def flush(self) -> Iterator[Output]:
        """End the run of cycles."""
        if self._join is not None:
            for cycle in self._join.flush():
                yield self.take(cycle)
            yield self.finish()

    def decided(self, block: CandidateBlock) -> Iterable[Event]:
        """Yield what the candidates just decided stand for."""
        return self.follow(block.accepted)
