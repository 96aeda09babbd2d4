"""The sink that turns a replay into a recording of the viewer, with its layout inside.

Steps, and steps that were missed or are false, are shown with every sample. They are found during
the replay, from the truth and the detections some seconds behind the signal, so that memory does
not grow with the recording.
"""

from __future__ import annotations

import errno
import math
import os
import shutil
import sys
import tempfile
import threading
from bisect import bisect_left, bisect_right
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from groundtrace.errors import OutputError
from groundtrace.pipeline.results import LAST_NS, room_for
from groundtrace.scratch import scratch_folder_until_exit
from groundtrace_codecs.signals import NS_PER_S, SignalBlock

from ..errors import ViewerError
from .annotations import log_annotations
from .blueprint import blueprint
from .context import ViewContext
from .decisions import PlainView, lane_labels, log_truth
from .legible import send_layout
from .process import connect, data_url, free_port, open_viewer
from .samples import REACH_NS, FullRate, planned
from .timeline import PAGE, SPAN, TIMELINE, TRUTH_LANES, Lane, about, log_axis, stream_of
from .views import VIEWS
from .wrong_decisions import verdicts

if TYPE_CHECKING:
    import subprocess
    from collections.abc import Iterable, Sequence
    from io import FileIO

    import rerun as rr

    from groundtrace.pipeline.engine import ReplaySession
    from groundtrace.pipeline.results import Results
    from groundtrace_codecs.events import Event

    from .context import View
    from .moments import PageMoments
    from .samples import Plan
    from .timeline import Bounds, Timeline

#: What is taken from the viewer's pipe at once, at most.
PIECE_BYTES = 1 << 20


class RerunSink:
    """Shows a replay on a Rerun timeline: in a file, in the native viewer, or for a browser's page.

    Parameters
    ----------
    path
        The ``.rrd`` to write; the layout is inside. May be None with ``spawn`` or ``web``.
    spawn
        Start the native viewer and show the replay while it runs.
    web
        Keep what a page needs that shows the replay when it has ended: its file and its
        :attr:`moments`, which :func:`~.web.browse.serve_replay` serves.
    port
        Of the viewer's data server (``spawn``); 0 chooses a free one.
    channels
        Whose spectrograms are shown; empty takes the first seismic channel's.
    full_rate
        What is shown at full rate of fast streams: ``none``, ``misses``, ``events``, ``all`` or
        FROM-TO in seconds; empty is ``all`` with ``spawn``, else ``misses``.
    map_tiles
        Show positions on a street map too, whose tiles the viewer loads from the internet.
    watched
        The file is read while it grows: all is written as it comes, and the layout first.

    Attributes
    ----------
    viewer
        The process started by ``spawn``, else None.
    path
        The ``.rrd``, a temporary one with ``web`` where none was given; else None.

    Raises
    ------
    ViewerError
        Where neither a path nor a viewer is given, or ``full_rate`` is something else.
    """

    def __init__(
        self,
        path: Path | None = None,
        *,
        spawn: bool = False,
        web: bool = False,
        port: int = 0,
        channels: Sequence[str] = (),
        full_rate: str = "",
        map_tiles: bool = False,
        watched: bool = False,
    ) -> None:
        if path is None and not spawn and not web:
            raise ViewerError("viewer: expected a file, spawn or web, found none of them")
        if path is None and web:
            path = scratch_folder_until_exit() / "replay.rrd"
        self.viewer: subprocess.Popen[bytes] | None = None
        self.path = path
        self._spawn = spawn
        self._web = web
        self._port = port or free_port()
        self._channels = tuple(channels)
        self._full_rate = FullRate.parse(full_rate) if full_rate else None
        self._map_tiles = map_tiles
        self._session: ReplaySession | None = None
        self._recording: rr.RecordingStream | None = None
        self._outlet: Outlet | None = None
        self._replay: TimelineReplay | None = None
        self._watched = watched
        self._laid_out: tuple[int, frozenset[str]] = (0, frozenset())
        self._events: list[Event] = []

    def expected(self, session: ReplaySession) -> str:
        """Return what the timeline of a session will weigh, one line for people."""
        return self._plan(session).words()

    def _plan(self, session: ReplaySession) -> Plan:
        """Return what is shown at full rate: a viewer beside a finite replay can hold all of it."""
        finite = self._spawn and not session.live
        return planned(self._full_rate or FullRate("all" if finite else "misses"), session)

    @property
    def summary(self) -> str:
        """What is shown at full rate, for people; empty before anything is."""
        return self._replay.close_ups.words() if self._replay is not None else ""

    def open(self, session: ReplaySession) -> None:
        """Begin a replay.

        Raises
        ------
        ViewerError
            Where the viewer does not start.
        """
        import rerun as rr

        recording = stream_of(session.name, session.application)
        viewers = []
        if self._spawn:
            limits = VIEWER_LIMITS if session.live else ()
            self.viewer = open_viewer(["--expect-data-soon", *limits], self._port)
            viewers.append(rr.GrpcSink(data_url(self._port)))
        growing = partial_of(self.path) if self.path is not None else None
        self._outlet = Outlet(recording, growing, *viewers, name=self.path)
        self._session, self._recording = session, recording
        self._watched = self._watched or self._spawn or (session.live and self._web)
        pace = _pace(session, watched=self._watched, native=self._spawn)
        # truth of what is still to come would show a time that nothing has reached
        shown = replace(session, labels=(), annotations=()) if session.live else session
        context = ViewContext(
            recording,
            shown,
            self._plan(session),
            chunk_s=pace.chunk_s,
            map_tiles=self._map_tiles,
            channels=self._channels,
            watched=self._watched,
        )
        self._replay = TimelineReplay(context, pace)
        if self._watched:
            self._send_layout(follow=True)

    def _send_layout(self, *, follow: bool) -> None:
        if self._recording is not None and self._session is not None and self._replay is not None:
            entities = self._replay.context.timeline.entities
            layout = blueprint(self._session, entities, self._replay.shown, follow=follow)
            self._laid_out = self._layout_key()
            send_layout(self._recording, layout)

    def write(self, item: SignalBlock | Event) -> None:
        """Take one block or event, in time order."""
        if self._replay is None:
            raise ViewerError("viewer: expected open() before write(), found none")
        self._replay.write(item)
        if self._web and not isinstance(item, SignalBlock):
            self._events.append(item)
        if self._watched and self._laid_out != self._layout_key():
            self._send_layout(follow=True)

    def _layout_key(self) -> tuple[int, frozenset[str]]:
        """Return what a layout depends on while data come: stages, and kinds of what is drawn."""
        if self._replay is None:
            return 0, frozenset()
        context = self._replay.context
        return len(context.stages), context.timeline.roles

    def abandon(self) -> None:
        """End without giving the file its name: what was written stays in NAME.partial."""
        outlet, self._outlet = self._outlet, None
        if outlet is not None:
            outlet.end()

    def close(self) -> None:
        """End the replay: write what is pending and the layout."""
        outlet, self._outlet = self._outlet, None
        if outlet is None or self._replay is None:
            return
        self._replay.close()
        self._send_layout(follow=False)
        outlet.finish()
        if self.path is not None:
            partial_of(self.path).replace(self.path)
        if self._spawn:
            self._go_to_first_event()

    @property
    def moments(self) -> PageMoments:
        """What a page of the replay can jump to; with ``web``, once it has ended.

        Raises
        ------
        ViewerError
            As :meth:`moments_within`.
        """
        return self.moments_within(math.inf)

    def moments_within(self, within_s: float) -> PageMoments:
        """Return what a page can jump to, causes and remedies as far as they are found in time.

        Parameters
        ----------
        within_s
            How long they are looked for [s].

        Raises
        ------
        ViewerError
            Before a replay, or without ``web``.
        """
        from .moments import moments_of_session

        return moments_of_session(self._ended, self._events, self._opens_ns, within_s)

    @property
    def decided(self) -> Results:
        """What a replay decided, with ``web``, once it has ended."""
        from .wrong_decisions import results_of

        return results_of(self._ended, self._events)

    @property
    def _ended(self) -> ReplaySession:
        """The session of a replay that has ended.

        Raises
        ------
        ViewerError
            Before a replay, or without ``web``.
        """
        if self._session is None or self._replay is None or not self._web:
            raise ViewerError("viewer: expected a replay for the web, found none")
        session, replayed_ns = self._session, self._replay.context.replayed_ns
        if session.live and replayed_ns is not None:
            session = replace(session, end_ns=replayed_ns[1])
        return session

    @property
    def _opens_ns(self) -> int | None:
        """Where a page opens [ns]; None stands for where its moments say."""
        return None

    def _go_to_first_event(self) -> None:
        """Pause where it opens; a file's layout cannot hold a cursor, a viewer's can be set."""
        first_ns = self._replay.context.opens_ns if self._replay is not None else None
        if self.viewer is None or self._session is None or first_ns is None:
            return
        client = connect(self.viewer, self._port)
        since_s = (first_ns - self._session.start_ns) / NS_PER_S
        client.set_time(TIMELINE, duration=since_s, play_state="paused")


#: Whether files can be pipes; a test of the other way takes them away.
PIPES = sys.platform != "win32"
#: Room that is left on a disk when a file is given up [bytes], and how often it is looked for [s].
#: Chosen by judgement: a timeline grows by less than 10 MB in such a time.
_SPARE_BYTES, _LOOK_S = 1 << 25, 0.1


class Outlet:
    """Where a stream of the viewer goes: into a file, to a viewer, or both.

    Where the disk is full, the thread by which the viewer writes files ends, and what waits for it
    waits for ever (rerun 0.41). So the viewer writes into a pipe that takes all there is, and a
    thread of ours writes the file. Where a system has no pipes among its files, the viewer writes,
    and the thread takes the file away from it while the disk still has some room.

    Parameters
    ----------
    recording
        The stream.
    path
        The file; None where there is none.
    viewers
        Where else it goes.
    name
        How the user knows the file; None is ``path``.

    Raises
    ------
    OutputError
        Where the file cannot be begun.
    """

    def __init__(
        self,
        recording: rr.RecordingStream,
        path: Path | None,
        *viewers: rr.GrpcSink,
        name: Path | None = None,
    ) -> None:
        import rerun as rr

        self._recording = recording
        self._path, self._name = path, name or path
        self._refused: OSError | None = None
        self._writer: threading.Thread | None = None
        self._ended = threading.Event()
        if path is None:
            recording.set_sinks(*viewers)
            return
        with room_for(name or path, path):
            file = path.open("wb", buffering=0)
        if sys.platform == "win32" or not PIPES:
            file.close()
            recording.set_sinks(rr.FileSink(path), *viewers)
            watched = (path.parent, viewers)
            self._writer = threading.Thread(target=self._watch, args=watched, daemon=True)
            self._writer.start()
            return
        with tempfile.TemporaryDirectory(prefix="groundtrace-") as folder:
            pipe = Path(folder) / "recording.rrd"
            os.mkfifo(pipe)
            end = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)  # before anybody writes
            recording.set_sinks(rr.FileSink(pipe), *viewers)
        os.set_blocking(end, True)
        copied = (os.fdopen(end, "rb", buffering=0), file)
        self._writer = threading.Thread(target=self._copy, args=copied, daemon=True)
        self._writer.start()

    def _copy(self, pipe: FileIO, file: FileIO) -> None:
        with pipe, file:
            while piece := pipe.read(PIECE_BYTES):
                rest = memoryview(piece if self._refused is None else b"")
                try:
                    while rest:
                        rest = rest[file.write(rest) :]
                except OSError as error:
                    self._refused = error

    def _watch(self, folder: Path, viewers: tuple[rr.GrpcSink, ...]) -> None:
        import rerun as rr

        while shutil.disk_usage(folder).free > _SPARE_BYTES:
            if self._ended.wait(_LOOK_S):
                return
        self._refused = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self._recording.set_sinks(rr.FileSink(os.devnull), *viewers)

    def end(self) -> None:
        """End the stream; a file stays as far as it came."""
        self._ended.set()
        self._recording.disconnect()
        if self._writer is not None:
            self._writer.join()

    def finish(self) -> None:
        """End the stream when all of it has arrived.

        Raises
        ------
        OutputError
            Where a file could not be written whole, as on a full disk; it is removed.
        """
        self._recording.flush()
        self.end()
        if self._refused is not None and self._path is not None and self._name is not None:
            self._path.unlink(missing_ok=True)
            raise OutputError(self._name, self._refused.strerror) from self._refused


def partial_of(path: Path) -> Path:
    """Return what a viewer's file is called while it is written."""
    return path.with_name(f"{path.name}.partial")


#: Events may lag this far behind the signal.
LAG_NS = 5 * NS_PER_S


class Pace(NamedTuple):
    """How much of a recording is collected before it is logged.

    Attributes
    ----------
    flush_ns
        Of events [ns].
    lag_ns
        Close-ups wait so long for events [ns].
    chunk_s
        Of signals [s]; None chooses by the rate.
    """

    flush_ns: int
    lag_ns: int
    chunk_s: float | None


#: Where nobody watches, where somebody does, and where the signal comes as it is recorded: to the
#: native viewer, and to a page. Chosen by judgement: few large chunks are read fast, and a person
#: notices a fifth of a second. Of a page bench/live_latency.py --browser, of 0.2, 0.5 and 1 s: a
#: browser that draws without a graphics card takes in few messages, and is 15, 10 and 2.6 s behind.
UNWATCHED = Pace(60 * NS_PER_S, LAG_NS, None)
WATCHED = Pace(NS_PER_S, REACH_NS[1] + NS_PER_S // 20, 0.5)
LIVE = WATCHED._replace(flush_ns=NS_PER_S // 5, chunk_s=0.1)
LIVE_PAGE = WATCHED._replace(chunk_s=0.25)
#: What a viewer may hold that follows a recording which may go on for days; it drops the oldest.
#: Chosen by judgement: beside it there is room on a laptop of 8 GB.
VIEWER_LIMITS = ("--memory-limit", "2GiB", "--server-memory-limit", "256MiB")


def _pace(session: ReplaySession, *, watched: bool, native: bool) -> Pace:
    if not watched:
        return UNWATCHED
    if not session.live:
        return WATCHED
    return LIVE if native else LIVE_PAGE


class TimelineReplay:
    """Logs one replay: hands every item to the views of its kind.

    Parameters
    ----------
    context
        Of the views.
    pace
        How much is collected before it is logged.
    """

    def __init__(self, context: ViewContext, pace: Pace) -> None:
        import rerun as rr

        session, timeline = context.session, context.timeline
        self.context = context
        self._flush_every_ns = pace.flush_ns
        self._flushed_ns = session.start_ns
        self.close_ups = CloseUps(timeline, context.plan, session, pace.lag_ns)
        view_types = dict.fromkeys(view for views in VIEWS.values() for view in views)
        made = {view: view(context) for view in view_types if view.fits(context)}
        self._of_kind = {
            kind: [made[view] for view in views if view in made] for kind, views in VIEWS.items()
        }
        self._plain = PlainView(context)
        self._views: list[View] = [*made.values(), self._plain]
        log_truth(timeline, lane_labels(session), TRUTH_LANES)
        log_annotations(timeline, context.lines, session.annotations)
        timeline.static(PAGE, rr.TextDocument(about(session), media_type="text/markdown"))

    @property
    def shown(self) -> Bounds | None:
        """What the map must show, as far as is known by now; None without a map."""
        return next(filter(None, (view.bounds for view in self._views)), None)

    def write(self, item: SignalBlock | Event) -> None:
        """Take one block or event."""
        if isinstance(item, SignalBlock) and not len(item):
            return
        self.context.take(item)
        for view in self._of_kind.get(type(item), (self._plain,)):
            view.add(item)
        if isinstance(item, SignalBlock):
            self._show_close_ups(item.last_ns)
            if item.last_ns - self._flushed_ns >= self._flush_every_ns:
                self._flushed_ns = item.last_ns
                self._flush(item.start_ns - LAG_NS)
                if self.context.session.live:
                    self.context.timeline.extend(item.last_ns)

    def _show_close_ups(self, last_ns: int | None) -> None:
        moments, context = self.close_ups.moments, self.context
        if context.stages.last("step") is not None:
            moments.judge()
        for time_ns in context.answers_ns:
            moments.step(time_ns)
        context.answers_ns.clear()
        self.close_ups.show(last_ns, self._views)

    def _flush(self, before_ns: int | None) -> None:
        for view in self._views:
            view.flush(before_ns)
        self.context.lanes.flush(before_ns)
        self.context.lines.flush()

    def close(self) -> None:
        """Log everything pending."""
        self._show_close_ups(None)
        for view in self._views:
            view.close()
        self._flush(None)
        log_axis(self.context.timeline, self.context.replayed_ns or self.context.span_ns)


#: Steps are matched to the truth with so much of both around them [ns].
MARGIN_NS = NS_PER_S
#: How often moments are looked for [ns], while nobody watches.
EVERY_NS = 2 * NS_PER_S
#: Moments this close to each other are one [ns].
SAME_NS = NS_PER_S // 20
#: Close-ups at the beginning may take this part of what all may: the rest is spread over time.
AT_ONCE = 0.25
LANE = "/state/8-full-rate"


class CloseUpTimes:
    """Finds the moments of a session as its steps come.

    Parameters
    ----------
    plan
        What is shown at full rate.
    session
        Gives the truth.
    lag_ns
        Steps may come this long after their signal [ns].
    """

    def __init__(self, plan: Plan, session: ReplaySession, lag_ns: int) -> None:
        self._plan = plan
        self._lag_ns = lag_ns
        self._every_ns = min(EVERY_NS, lag_ns)
        steps = sorted(x for x in session.labels if x.kind == "step")
        self._true, self._true_ns = steps, [x.time_ns for x in steps]
        spans = tuple(x for x in session.labels if x.kind in ("walking", "ignore"))
        self._session = replace(session, labels=spans)
        self._steps: list[int] = []
        self._late: list[int] = []
        self._reached_ns = (session.shown_ns or (session.start_ns, 0))[0]
        self._passed = 0
        self._judged = False

    def judge(self) -> None:
        """Say that a stage detects steps, which can be missed."""
        self._judged = bool(self._true)

    def step(self, time_ns: int) -> None:
        """Take a detected step."""
        if time_ns < self._reached_ns:
            self._late.append(time_ns)
        else:
            self._steps.append(time_ns)

    def passed(self, last_ns: int) -> None:
        """Say how far the signal has come."""
        self._passed = bisect_right(self._true_ns, last_ns)

    def ready(self, last_ns: int | None) -> list[int]:
        """Return the moments that can be told now that the signal came so far; None is the end."""
        if last_ns is None:
            until = max([self._reached_ns, *self._steps, *self._true_ns[: self._passed][-1:]]) + 1
        else:
            until = last_ns - self._lag_ns
            if until - self._reached_ns < self._every_ns:
                return []
        moments = self._between(self._reached_ns, until)
        late = self._late if self._chosen("step") else []
        self._reached_ns, self._late = until, []
        self._steps = [t for t in self._steps if t >= until - MARGIN_NS]
        return _apart(sorted([*late, *moments]))

    def _between(self, start_ns: int, end_ns: int) -> list[int]:
        """Return the moments of a half-open span."""
        if not self._judged:
            steps = self._steps if self._chosen("step") else []
            return [t for t in steps if start_ns <= t < end_ns]
        reach = start_ns - MARGIN_NS, end_ns + MARGIN_NS
        first, last = bisect_left(self._true_ns, reach[0]), bisect_left(self._true_ns, reach[1])
        labels = (*self._session.labels, *self._true[first:last])
        near = [t for t in self._steps if reach[0] <= t < reach[1]]
        outcomes = verdicts(replace(self._session, labels=labels), near, reach)
        judged = [one.time_ns for one in outcomes if self._chosen(one.verdict)]
        steps = near if self._chosen("step") else []
        return [t for t in (*judged, *steps) if start_ns <= t < end_ns]

    def _chosen(self, what: str) -> bool:
        """Whether something is a moment; without a judgement events stand for misses."""
        mode = self._plan.mode
        if what == "step":
            return mode in ("all", "span", "events") or (mode == "misses" and not self._judged)
        return what == "missed" or (what == "false" and mode == "misses")


def _apart(moments: Iterable[int]) -> list[int]:
    """Return moments without those that follow another at once."""
    retained: list[int] = []
    for time_ns in moments:
        if not retained or time_ns - retained[-1] >= SAME_NS:
            retained.append(time_ns)
    return retained


class CloseUps:
    """Shows every sample around moments.

    Parameters
    ----------
    timeline
        Where to.
    plan
        What is shown at full rate.
    session
        What is replayed.
    lag_ns
        Steps may come this long after their signal [ns].

    Attributes
    ----------
    shown, left_out
        Number of moments that have their samples, and that would have taken too much.
    """

    def __init__(self, timeline: Timeline, plan: Plan, session: ReplaySession, lag_ns: int) -> None:
        self.moments = CloseUpTimes(plan, session, lag_ns)
        self.shown = self.left_out = 0
        self._plan = plan
        self._lane = Lane(timeline, LANE, {"every sample": SPAN})
        end_ns = LAST_NS if session.live else session.end_ns + 1
        self._span_ns = session.shown_ns or (session.start_ns, end_ns)
        self._shown_to_ns = self._span_ns[0]
        self._spent_bytes = 0.0

    def show(self, last_ns: int | None, views: Sequence[View]) -> None:
        """Show what can be told now that the signal came so far; None is the end."""
        if self._plan.mode == "none":
            return
        if last_ns is not None:
            self.moments.passed(last_ns)
        for time_ns in self.moments.ready(last_ns):
            if not self._plan.close_ups or self._show_around(time_ns, views):
                for view in views:
                    view.near(time_ns)
        self._lane.flush(None if last_ns is None else self._shown_to_ns - sum(REACH_NS))

    def words(self) -> str:
        """Return what is shown at full rate."""
        plan = self._plan
        if not plan.close_ups:
            return plan.shown
        count = f"{self.shown} of {self.shown + self.left_out}" if self.left_out else self.shown
        return f"every sample around {count} {plan.subject}"

    def _show_around(self, time_ns: int, views: Sequence[View]) -> bool:
        """Show the samples around a moment, unless they would take too much."""
        before_ns, after_ns = self._plan.reach_ns
        start_ns = max(time_ns - before_ns, self._shown_to_ns)
        end_ns = min(time_ns + after_ns, self._span_ns[1])
        cost = max(0, end_ns - start_ns) / NS_PER_S * self._plan.second_bytes
        if self._spent_bytes + cost > self._allowed(time_ns):
            self.left_out += 1
            return False
        self.shown += 1
        if start_ns < end_ns:
            self._spent_bytes += cost
            self._shown_to_ns = end_ns
            self._lane.add(start_ns, "every sample", end_ns)
            for view in views:
                view.close_up(start_ns, end_ns)
        return True

    def _allowed(self, time_ns: int) -> float:
        """Return what close-ups up to a time may take: the recording's end gets its part."""
        if self._plan.mode == "events":
            return np.inf
        start_ns, end_ns = self._span_ns
        elapsed = (time_ns - start_ns) / max(1, end_ns - start_ns)
        return self._plan.budget_bytes * max(AT_ONCE, min(1.0, elapsed))
