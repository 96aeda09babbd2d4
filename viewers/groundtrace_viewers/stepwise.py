"""What is shown at each step: arrivals, regions and signs, bearings, and what was around it."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from groundtrace.localizers.api import LocalizerParameters
from groundtrace_codecs.events import Bearing
from groundtrace_codecs.signals import NS_PER_S, SEISMIC_QUANTITIES

from .decision import PickerCurve
from .details import Details
from .fine_spectrogram import LEAST_RATE_HZ, SpectrumViews
from .recipe import used
from .stations import StationViews

if TYPE_CHECKING:
    from collections.abc import Sequence

    from groundtrace.sinks import Session
    from groundtrace_codecs.events import Gap, Pick, StageSpec, StepEvent
    from groundtrace_codecs.signals import SignalBlock, Stream

    from .details import Views
    from .hits import RegionLog
    from .palette import SensorColours
    from .sensor_map import SensorMap
    from .timeline import Timeline

#: What is lit at a step goes out after this, or with the next step [ns].
LIT_NS = NS_PER_S // 2
#: Signal that must have come before what lies around a step is complete [ns].
COMPLETE_NS = NS_PER_S * 7 // 20
#: So many arrivals are remembered: a step is announced when a later arrival closes its window.
MOST_PICKS = 1024
#: The plugin that locates by regions.
BY_SIGNS = "so-tdoa"


@dataclass(frozen=True, slots=True)
class Due:
    """A step that waits for its signal, and for arrivals that are refined after it is found."""

    time_ns: int
    topic: str


class Stepwise(Details):
    """Logs everything that belongs to single steps.

    Parameters
    ----------
    timeline
        Where to.
    session
        What is replayed.
    colours
        Of the sensors.
    site
        The map, or None.
    channels
        Whose spectrograms are wanted; empty takes the first seismic channel's.
    close
        Whether anything is shown at every sample.
    """

    def __init__(
        self,
        timeline: Timeline,
        session: Session,
        colours: SensorColours,
        site: SensorMap | None,
        channels: Sequence[str] = (),
        *,
        close: bool = True,
    ) -> None:
        self._timeline = timeline
        self._session = session
        self._colours = colours
        self._close = close
        self._window_s = LocalizerParameters().window_s
        self._picks: deque[Pick] = deque(maxlen=MOST_PICKS)
        self._due: deque[Due] = deque()
        self._lit_ns: int | None = None
        self._curves: list[PickerCurve] = []
        self._regions: RegionLog | None = None
        self._picking: StageSpec | None = None
        self._signs = site.names if site is not None else None
        self._stations: dict[str, StationViews] = {}
        self._spectra: dict[str, SpectrumViews] = {}
        for stream in session.streams:
            self._begin(stream, channels)

    def _begin(self, stream: Stream, channels: Sequence[str]) -> None:
        if stream.irregular or not stream.columns_of(SEISMIC_QUANTITIES):
            return
        site = self._session.geometry
        if site is not None and StationViews.fits(stream, site):
            views = StationViews(self._timeline, stream, site, self._colours)
            self._stations[stream.topic] = views
        fine = self._close and stream.rate_hz >= LEAST_RATE_HZ
        if fine and (channels or not self._spectra):
            self._spectra[stream.topic] = SpectrumViews(self._timeline, stream, channels)

    def stage(self, spec: StageSpec, colour: int) -> None:
        """Take a stage; ``colour`` is that of its places."""
        if spec.emits == "pick":
            self._picking = spec
            if spec.trace and self._close:
                curve = PickerCurve(self._timeline, self._session, spec, self._colours)
                self._curves.append(curve)
        elif spec.plugin == BY_SIGNS and self._regions is None:
            self._begin_regions(spec, colour)

    def _begin_regions(self, spec: StageSpec, colour: int) -> None:
        # shapely takes a while to load, and only regions need it
        from .hits import RegionLog

        geometry, picking = self._session.geometry, self._picking
        if geometry is None or picking is None or not RegionLog.fits(geometry, picking):
            return
        found = used(self._session, spec)
        window_s = found.parameters.window_s if found is not None else self._window_s
        self._regions = RegionLog(self._timeline, geometry, picking, window_s, colour)

    def signal(self, block: SignalBlock) -> None:
        """Take a block."""
        for curve in self._curves:
            curve.feed(block)
        if block.topic in self._stations:
            self._stations[block.topic].signal(block)
        if block.topic in self._spectra:
            self._spectra[block.topic].signal(block)
        while self._due and self._due[0].time_ns + COMPLETE_NS <= block.last_ns:
            self._show(self._due.popleft())

    def gap(self, gap: Gap) -> None:
        """Take a gap."""
        for curve in self._curves:
            curve.feed(gap)

    def pick(self, pick: Pick) -> None:
        """Take an arrival."""
        self._picks.append(pick)
        for curve in self._curves:
            curve.expect(pick.time_ns)
        for views in (self._stations, self._spectra):
            if pick.topic in views:
                views[pick.topic].expect(pick.time_ns)

    def expect(self, time_ns: int) -> None:
        """Take a true step, which may be missed."""
        for curve in self._curves:
            curve.expect(time_ns)
        for spectra in self._spectra.values():
            spectra.expect(time_ns)

    def near(self, time_ns: int) -> None:
        """Show decision functions and spectra at every sample around a moment."""
        for curve in self._curves:
            curve.show(time_ns)
        for spectra in self._spectra.values():
            spectra.show(time_ns)

    def step(self, step: StepEvent) -> None:
        """Take a step: what there is to say of it is shown when its signal is complete."""
        self._due.append(Due(step.time_ns, step.topic))

    def bearing(self, bearing: Bearing) -> None:
        """Take a bearing; it comes with its step."""
        for views in self._stations.values():
            views.bearing(bearing)

    def close(self) -> None:
        """Show the last steps."""
        while self._due:
            self._show(self._due.popleft())
        if self._lit_ns is not None:
            self._put_out(self._lit_ns + LIT_NS)
        self.flush()

    def flush(self, before_ns: int | None = None) -> None:  # noqa: ARG002
        """Log what is pending."""
        if self._regions is not None:
            self._regions.flush()
        for views in self._stations.values():
            views.flush()

    def _show(self, due: Due) -> None:
        if self._lit_ns is not None and self._lit_ns + LIT_NS < due.time_ns:
            self._put_out(self._lit_ns + LIT_NS)
        self._lit_ns = due.time_ns
        picks = self._picks_of(due)
        if self._signs is not None:
            self._signs.step(due.time_ns, picks)
        if self._regions is not None:
            self._regions.step(due.time_ns, picks)
        if due.topic in self._stations:
            self._stations[due.topic].step(due.time_ns, picks)

    def _picks_of(self, due: Due) -> list[Pick]:
        """Return the arrivals of a step, of the stage that has the last word on them."""
        end_ns = due.time_ns + round(self._window_s * NS_PER_S)
        stage = self._picking.stage if self._picking is not None else ""
        return [
            p
            for p in self._picks
            if due.time_ns <= p.time_ns <= end_ns and (p.topic, p.stage) == (due.topic, stage)
        ]

    def _put_out(self, time_ns: int) -> None:
        if self._signs is not None:
            self._signs.clear(time_ns)
        if self._regions is not None:
            self._regions.clear(time_ns)
        for views in self._stations.values():
            views.clear(time_ns)

    views: ClassVar[Views] = {Bearing: bearing}
