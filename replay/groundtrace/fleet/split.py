"""One long recording on many workers: spans of it are replayed on an engine, and joined here."""

from __future__ import annotations

import platform
import queue
import threading
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from groundtrace_codecs.errors import CodecError
from groundtrace_codecs.events import Label
from groundtrace_codecs.importers.units import RANGES
from groundtrace_codecs.location import Location, is_url, without_secrets
from groundtrace_codecs.mcap.byte_source import RemoteBytes
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S, SignalBlock

from ..api.replay import PlannedReplay
from ..errors import GroundtraceError, RecordingError
from ..pipeline.chain import build_pipeline
from ..pipeline.config import parse_pipeline
from ..pipeline.engine import EventList
from ..pipeline.results import package_versions
from ..pipeline.source import Source
from ..pipeline.split import (
    JoinError,
    SpanReplay,
    begun_earlier,
    in_spans,
    joined,
    measured_in_spans,
    replay_span,
    spans_of,
    warm_up_s,
)
from ..pipeline.stage import StageRunner
from .run import (
    NEVER_ENDED,
    Replayed,
    Software,
    check_software,
    code_sha256,
    evaluate,
    invisible,
    owners_of,
    ready_for,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterator, Sequence

    from groundtrace_codecs.geometry import Geometry
    from groundtrace_codecs.mcap.chunks import Damage

    from ..api.files import Report
    from ..explain.suitability import Prepared
    from ..pipeline.engine import ReplayCounts, Sink
    from ..pipeline.split import JoinState, Span
    from .engines import Engine
    from .run import Done, Task

T = TypeVar("T")

#: A span is so many times as long as its warm-up, where the recording is long enough for all
#: workers to have one. Chosen by judgement: warm-ups then cost a twentieth.
WARM_UPS = 20


@dataclass(frozen=True, slots=True)
class SpanTask:
    """A span of a recording through the stages of a pipeline that can begin in its middle.

    Attributes
    ----------
    location, folder
        Path or URL, and what a path is relative to.
    size
        Of the recording [bytes]: that another file is there is told by it.
    recipe
        The pipeline, TOML.
    geometry, labels
        Of the recording, or given instead.
    span
        Which one.
    software
        What is to decide.
    """

    location: Location
    folder: str
    size: int
    recipe: str
    geometry: Geometry | None
    labels: tuple[Label, ...]
    span: Span
    software: Software

    @property
    def path(self) -> Path:
        """Where the recording lies; of a URL its public part."""
        return Path("" if is_url(self.location) else self.folder, self.location)


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why a worker could not replay a span, in a line."""

    text: str


def replayed(task: SpanTask) -> SpanReplay | Refusal:
    """Replay a span, in a process of its own.

    Raises
    ------
    MisfitError
        Where this process decides with other software than the run has.
    """
    check_software(task.software)
    remote = is_url(task.location)
    if not remote and not task.path.is_file():
        return Refusal(f"{task.path.name}: {invisible(platform.node())}")
    try:
        with _KEPT.opened(task) as recording:
            if recording.file.size != task.size:
                sizes = f"expected {task.size} bytes, found {recording.file.size} on worker"
                return Refusal(f"{recording.name}: {sizes} {platform.node()}")
            config = parse_pipeline(task.recipe.encode(), task.path.name)
            chain = build_pipeline(config, task.geometry, task.labels)
            return replay_span(recording, chain, task.span)
    except (CodecError, GroundtraceError) as error:
        return Refusal(without_secrets(str(error)))
    except OSError as error:
        reason = error.strerror or str(error)
        return Refusal(f"{task.path.name}: expected a file to use, found: {reason}")


class _LastRecording:
    """The local recording that a worker opened last: the next span is most likely of it too.

    To open an hour of 16 channels at 20 kHz takes as long as to replay half a minute of it.
    """

    def __init__(self) -> None:
        self._file: tuple[int, ...] = ()
        self._recording: Recording | None = None

    @contextmanager
    def opened(self, task: SpanTask) -> Iterator[Recording]:
        """Open the recording of a task, or take the one that is open, if the file is the same."""
        if is_url(task.location):
            with Recording.open(RemoteBytes(task.location)) as recording:
                yield recording
            return
        status = task.path.stat()
        file = status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns
        if self._recording is None or self._file != file:
            self.close()
            self._recording, self._file = Recording.open(task.path), file
        yield self._recording

    def close(self) -> None:
        """Close the recording that is open."""
        if self._recording is not None:
            self._recording.close()
        self._recording, self._file = None, ()


_KEPT = _LastRecording()


@dataclass(slots=True)
class SplitReplay:
    """A replay whose spans are replayed on an engine.

    Attributes
    ----------
    plan
        Of the whole recording.
    location
        Where workers find it.
    engine, workers
        Where spans are replayed, and by about how many.
    report
        Told in a line what a person should know.
    count
        Of spans; None: by the recording's length, the warm-up and the workers.
    again
        Spans that were replayed again, since a join had shown that they began too late.
    damage
        What was left out of the recording.
    """

    plan: PlannedReplay
    location: Location
    engine: Engine
    workers: int
    report: Report
    count: int | None = None
    again: int = 0
    damage: set[Damage] = field(default_factory=set)

    def spans(self) -> list[Span]:
        """Return the spans; fewer than two where the recording is too short."""
        warm_s, recording = warm_up_s(self.plan.ready.chain), self.plan.recording
        length_s = (recording.end_ns - recording.start_ns) / NS_PER_S
        count = self.count
        if count is None:
            most, wanted = int(length_s / warm_s), int(length_s / (WARM_UPS * warm_s))
            count = max(1, min(most, max(wanted, self.workers)))
        return spans_of(recording, warm_s, count)

    @property
    def worth_it(self) -> bool:
        """Whether the recording can be split, and is longer than two spans of usual length."""
        recording, warm_s = self.plan.recording, warm_up_s(self.plan.ready.chain)
        length_s = (recording.end_ns - recording.start_ns) / NS_PER_S
        return not self.one_go() and length_s > 2 * WARM_UPS * warm_s

    def _too_short(self) -> str:
        """Return why there are fewer than two spans."""
        warm_s = warm_up_s(self.plan.ready.chain)
        recording = self.plan.recording
        if self.workers < 2 and (recording.end_ns - recording.start_ns) / NS_PER_S >= 2 * warm_s:
            return f"for one worker it is shorter than two spans of {WARM_UPS * warm_s:.0f} s"
        return f"it is shorter than two warm-ups of {warm_s:.0f} s"

    def one_go(self) -> str:
        """Return why the recording cannot be split; empty where it can."""
        recording, chain = self.plan.recording, self.plan.ready.chain
        if not chain.stages:
            return f"{chain.config.name} has no stages"
        if not in_spans(chain):
            return f"{chain.stages[0].name} depends on all that comes before"
        return "its clock was set back" if recording.set_back else ""

    def run(
        self, sinks: Sequence[Sink], *, signal: bool, progress: Callable[[float], None]
    ) -> ReplayCounts:
        """Replay into sinks, from opening to closing them.

        Parameters
        ----------
        sinks
            Where to.
        signal
            Whether they take samples.
        progress
            Called with the part that is done, 0 to 1.

        Raises
        ------
        RecordingError
            Where a worker cannot replay a span, or none is there.
        """
        plan = self.plan
        why = self.one_go()
        spans = [] if why else self.spans()
        if len(spans) < 2:
            why = why or self._too_short()
            self.report(f"{plan.recording.name} is replayed in one go: {why}")
            return plan.run(sinks, progress=progress)
        self.report(self._progress_text(spans))
        chain = plan.ready.chain
        samples = plan.signal() if signal or self._wants_signal() else None
        with closing(self._right(spans)) as right:
            given = joined(chain, Source(plan.recording).streams, right, samples)
            try:
                return plan.run(sinks, progress=progress, given=given)
            except JoinError as error:
                mismatch = f"expected {error} to decide as in one go, found another verdict"
                raise RecordingError(f"{plan.recording.name}: --engine: {mismatch}") from None

    def _wants_signal(self) -> bool:
        """Return whether samples are wanted here: by a stage, or to judge sensors that are worn."""
        chain = self.plan.ready.chain
        split_stages = {*in_spans(chain), *measured_in_spans(chain)}
        alone = [stage for stage in chain.stages if stage.name not in split_stages]
        needs = [n for s in alone if isinstance(s, StageRunner) for n in s.kind.takes]
        worn = any(c.quantity in RANGES for s in self.plan.session.streams for c in s.channels)
        return worn or any(need.kind is SignalBlock for need in needs)

    def _progress_text(self, spans: Sequence[Span]) -> str:
        """Return in a line how a recording is split."""
        chain, recording = self.plan.ready.chain, self.plan.recording
        each_s = (recording.end_ns - recording.start_ns) / NS_PER_S / len(spans)
        warm_s, split, measured = warm_up_s(chain), in_spans(chain), measured_in_spans(chain)
        split_text = f"{len(spans)} spans of {each_s:.0f} s, each after {warm_s:.0f} s of warm-up"
        alone = [stage.name for stage in chain.stages if stage.name not in split]
        rest = f"; in one go, since they depend on all before: {', '.join(alone)}" if alone else ""
        rest += f", the signal of {', '.join(measured)} measured in spans" if measured else ""
        return f"{recording.name}: {split_text}, through {', '.join(split)}{rest}"

    def _right(self, spans: Sequence[Span]) -> Generator[SpanReplay]:
        """Yield what spans give in their order, each compared with the one before where they join.

        Where they differ, the later one is replayed again, here, from earlier on.
        """
        recording = self.plan.recording
        first = recording.file.start_ns // Source(recording).width_ns
        task = self._task(spans[0])
        tasks = [replace(task, span=span) for span in spans]
        waiting: dict[int, SpanReplay] = {}
        end: JoinState | None = None
        turn = 0
        with closing(ahead(self.engine.run(replayed, tasks, self.report), self.workers)) as answers:
            for number, answer in answers:
                waiting[number] = self._given(answer)
                while turn in waiting:
                    span_replay, span = waiting.pop(turn), spans[turn]
                    while end is not None and (why := span_replay.differs(end)):
                        self.again += 1
                        span = begun_earlier(span, end, first)
                        self.report(f"span {turn + 1} is replayed again from earlier on: {why}")
                        span_replay = self._given(replayed(replace(tasks[turn], span=span)))
                    end = (
                        span_replay.end
                        if end is None or span_replay.end is None
                        else span_replay.end.after(end)
                    )
                    turn += 1
                    self.damage.update(span_replay.damage)
                    yield span_replay

    def _given(self, answer: SpanReplay | Refusal | None) -> SpanReplay:
        if answer is None:
            raise RecordingError(f"{self.plan.recording.name}: {NEVER_ENDED}")
        if isinstance(answer, Refusal):
            raise RecordingError(answer.text)
        return answer

    def _task(self, span: Span) -> SpanTask:
        """Return the task of a span; that of another differs in its span alone."""
        plan = self.plan
        chain, recording = plan.ready.chain, plan.recording
        takes = [s.kind.takes for s in chain.stages if isinstance(s, StageRunner)]
        labelled = any(need.kind is Label for needs in takes for need in needs)
        software = Software(
            code_sha256(),
            tuple(f"{name} {number}" for name, number in package_versions().items()),
            owners_of(chain.config),
        )
        return SpanTask(
            self.location,
            str(Path.cwd()),
            recording.file.size,
            chain.recipe(),
            recording.geometry,
            recording.labels if labelled else (),
            span,
            software,
        )


@dataclass(frozen=True, slots=True)
class LongOnes:
    """Does the tasks of a fleet whose recordings are long: joined here of spans.

    Attributes
    ----------
    engine, workers, report
        As those of :class:`SplitReplay`.
    """

    engine: Engine
    workers: int
    report: Report

    def __call__(self, task: Task) -> Done | None:
        """Do a task; None where its recording is short, cannot be split, or cannot be opened."""
        try:
            with Recording.open(opened_by(task)) as opened:
                split = self._split(task, opened, ready_for(task, opened))
                if not split.worth_it:
                    return None
        except (CodecError, GroundtraceError, OSError):  # told by the worker that is given it
            return None
        return evaluate(task, self._replayed)

    def _split(self, task: Task, opened: Recording, ready: Prepared) -> SplitReplay:
        plan = PlannedReplay.of(opened, task.path, ready)
        return SplitReplay(plan, task.location, self.engine, self.workers, self.report)

    def _replayed(self, task: Task, opened: Recording, ready: Prepared) -> Replayed:
        split, sink = self._split(task, opened, ready), EventList()
        tally = split.run([sink], signal=False, progress=lambda _: None)
        return Replayed(tuple(sink.events), tally.samples, {*opened.damage, *split.damage})


def opened_by(task: Task) -> Path | RemoteBytes:
    """Return what to open the recording of a task by."""
    return RemoteBytes(task.location) if is_url(task.location) else task.path


#: What stands for the end of what is taken ahead.
_END = object()


def ahead(answers: Generator[T], room: int) -> Generator[T]:
    """Yield what a generator gives, which goes on in another thread meanwhile.

    So workers are given their next task while what they gave is made use of.

    Parameters
    ----------
    answers
        The generator; it is closed at the end.
    room
        So many of its answers wait at most.
    """
    pending: queue.Queue[Any] = queue.Queue(maxsize=max(room, 1))
    over = threading.Event()

    def put(item: object) -> None:
        while not over.is_set():
            with suppress(queue.Full):
                pending.put(item, timeout=0.1)
                return

    def fill() -> None:
        try:
            with closing(answers):
                for answer in answers:
                    put((answer, None))
                    if over.is_set():
                        return
        except BaseException as error:  # whatever it is, it is raised where it is due
            put((None, error))
        put(_END)

    thread = threading.Thread(target=fill, name="groundtrace-spans")
    thread.start()
    try:
        while (item := pending.get()) is not _END:
            answer, error = item
            if error is not None:
                raise error
            yield answer
    finally:
        over.set()
        thread.join()
