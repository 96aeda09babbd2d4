"""The run of a fleet: recordings through pipelines, as tasks for an engine, into two tables.

A task is the unit of work: one recording through one pipeline, scored and explained, step by step.
Its result is a part, written to a folder; a task whose workers were killed gives a row that says
so.
"""

from __future__ import annotations

import ctypes
import glob
import hashlib
import importlib
import itertools
import os
import platform
import re
import sys
import threading
import time
from collections import defaultdict
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any, Self

import msgspec

from groundtrace_codecs.annotations import journal_of, sidecar_path
from groundtrace_codecs.errors import CodecError
from groundtrace_codecs.events import Gap
from groundtrace_codecs.location import Location, is_url, without_secrets
from groundtrace_codecs.mcap.byte_source import RemoteBytes, file_system
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S

from ..api.known_truth import truth_of_recording
from ..api.pipelines import default_pipeline
from ..api.replay import with_warnings
from ..errors import GroundtraceError, PipelineError, RecordingError
from ..evaluation.matching import STEP_TOLERANCE_S
from ..evaluation.report import answers_of, score_events
from ..evaluation.truth import scored_truth
from ..explain.reasons import StepReasons
from ..explain.suitability import Prepared, prepared
from ..explain.unfiltered import Unfiltered
from ..export.base import file_part
from ..pipeline.chain import build_pipeline
from ..pipeline.config import load_pipeline, named_pipelines, parse_pipeline, with_settings
from ..pipeline.engine import EventList, replay
from ..pipeline.plugins import plugins
from ..pipeline.results import (
    RUN,
    Provenance,
    Results,
    evidence_of,
    file_sha256,
    given_to,
    package_versions,
)
from ..pipeline.source import Source
from ..runtime import installed_version
from .engines import OVERDUE, MisfitError
from .table import FIGURES, FORMAT, Joined, Listed, Part, Row, StepRow, failed, join

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Mapping, Sequence

    from groundtrace_codecs.events import Event, Label
    from groundtrace_codecs.mcap.byte_source import ByteSource
    from groundtrace_codecs.mcap.chunks import Damage

    from ..evaluation.report import Score
    from ..pipeline.chain import Pipeline
    from ..pipeline.config import PipelineConfig
    from ..pipeline.warned import Warned
    from .engines import Engine
    from .table import Parts

#: Recordings whose bytes are read at once to find their parts. Chosen by judgement: disks and
#: networks gain little by more at once.
_READERS = 8


@dataclass(slots=True)
class Count:
    """How far a run is.

    Attributes
    ----------
    done, known, failed
        Tasks that went well, were done before, and ended in an error.
    left_out
        Which workers were given none, and why: a line for each.
    """

    done: int = 0
    known: int = 0
    failed: int = 0
    left_out: list[str] = field(default_factory=list)

    @property
    def total(self) -> int:
        """Tasks behind us."""
        return self.done + self.known + self.failed


def tasks_of(
    locations: Sequence[Location],
    recipes: Sequence[Recipe],
    tolerance_s: float,
    truths: Mapping[Location, Path],
    limit_s: float | None = None,
) -> list[Task]:
    """Return a task for each recording and pipeline, recording by recording."""
    software = Software(
        code_sha256(),
        tuple(f"{name} {number}" for name, number in package_versions().items()),
        tuple(sorted({owner for recipe in recipes for owner in recipe.owners})),
    )
    return [
        Task(
            location,
            recipe,
            tolerance_s,
            str(truths[location].resolve()) if location in truths else None,
            folder=str(Path.cwd()),
            limit_s=limit_s,
            software=software,
            made_by=(platform.node(), os.getpid()),
        )
        for location in locations
        for recipe in recipes
    ]


def shard(tasks: Sequence[Task], index: int, count: int) -> list[Task]:
    """Return the tasks of one shard: those of every ``count``-th recording."""
    order = {location: i for i, location in enumerate(dict.fromkeys(t.location for t in tasks))}
    return [task for task in tasks if order[task.location] % count == index - 1]


def run(
    tasks: Sequence[Task],
    engine: Engine,
    parts: Parts,
    count: Count,
    shown: Callable[[float], None],
    left_out: Callable[[str], None],
    *,
    resume: bool,
    here: Callable[[Task], Done | None] = lambda _: None,
) -> list[Listed]:
    """Do all tasks; return what the tables are to hold, in the order of the tasks.

    Parameters
    ----------
    tasks
        What to do.
    engine
        Where to do it.
    parts
        Where what comes of it is kept, as soon as it comes.
    count
        Counts, also where the run is interrupted.
    shown
        Is told the number of tasks behind us.
    left_out
        Is told, in a line, which worker is given no task, and why.
    resume
        Leave out tasks whose parts are there.
    here
        Does a task in this process, or returns None where a worker is to do it.

    Raises
    ------
    RecordingError
        Where a cluster is not reached, or no worker is of this run.
    """

    def leave_out(line: str) -> None:
        count.left_out.append(line)
        left_out(line)

    keys = [""] * len(tasks)
    todo = _knowing(tasks, parts) if resume else tasks
    for index, done in _answers(todo, engine, leave_out, here):
        keys[index] = done.key
        if done.data is None:
            count.known += 1
        else:
            parts.write(done.key, done.data, failed=done.failed)
            count.failed += done.failed
            count.done += not done.failed
        shown(count.total)
    return [Listed(task.location, key) for task, key in zip(tasks, keys, strict=True)]


def _answers(
    tasks: Sequence[Task],
    engine: Engine,
    left_out: Callable[[str], None],
    here: Callable[[Task], Done | None],
) -> Iterator[tuple[int, Done]]:
    others = []
    for index, task in enumerate(tasks):
        if (local_done := here(task)) is None:
            others.append(index)
        else:
            yield index, local_done
    with closing(engine.run(evaluate, [tasks[index] for index in others], left_out)) as answers:
        for number, done in answers:
            index = others[number]
            yield index, lost(tasks[index]) if done is None else done


def join_parts(
    tasks: Sequence[Task], parts: Parts, table: Path, command: str = "", *, partial: bool = False
) -> tuple[Joined, int]:
    """Write the tables of all tasks out of parts that others made.

    Parameters
    ----------
    tasks, parts, table, command
        What was to be done, what came of it, where to, and what the tables say they were made by.
    partial
        Leave out what is missing or broken.

    Returns
    -------
    What was joined, and how many parts are missing or broken.

    Raises
    ------
    RecordingError
        Where some are so and ``partial`` is not given, or all are.
    """
    with ThreadPoolExecutor(_READERS) as readers:
        keys = list(readers.map(_key_in_time, tasks))
    listed = [Listed(task.location, key) for task, key in zip(tasks, keys, strict=True)]
    missing = [item for item in listed if not parts.has(item.key)]
    if missing and (not partial or len(missing) == len(listed)):
        raise RecordingError(
            f"{parts.folder}: expected {len(listed)} whole parts, found "
            f"{len(listed) - len(missing)}; the first that is missing or broken is of "
            f"{missing[0].location}"
        )
    there = [item for item in listed if item not in set(missing)] if missing else listed
    return join(parts, there, table, command), len(missing)


def _key_in_time(task: Task) -> str:
    """Return the key of a task's part; that of unread bytes where reading takes too long."""
    try:
        with TimeLimit(task):
            return identity_of(task).key
    except TimeLimitError:
        return _key(task, "")


def _knowing(tasks: Sequence[Task], parts: Parts) -> list[Task]:
    """Return the tasks, each told the keys that may be its own: it finds out which by its bytes."""
    keys: dict[str, set[str]] = defaultdict(set)
    for key in parts.done():
        keys[key.rpartition("-")[0]].add(key)
    return [replace(t, done_keys=frozenset(keys.get(name_part(t.location), ()))) for t in tasks]


#: Name of what is chosen for each recording where no pipeline is asked for.
FITTING = "fitting"
#: How much of the end of a remote file tells it from others: in an MCAP file that was ended well,
#: the CRC of all data and the index. Chosen by judgement: more than the index of most recordings.
_END_BYTES = 1 << 18


@dataclass(frozen=True, slots=True)
class Recipe:
    """A pipeline to run.

    Attributes
    ----------
    name
        For people.
    toml
        With every parameter; empty for what fits each recording.
    sha256
        Of that, the tolerance, and the versions that decide.
    owners
        Name and version of the packages that bring its plugins.
    """

    name: str
    toml: str
    sha256: str
    owners: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Software:
    """What decides, for workers to compare with theirs.

    Attributes
    ----------
    code
        Digest of the code, see `code_sha256`.
    versions
        Name and version of Python and of the packages that decide.
    owners
        The same of the packages that bring plugins.
    """

    code: str = ""
    versions: tuple[str, ...] = ()
    owners: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Task:
    """One recording through one pipeline.

    Attributes
    ----------
    location
        Path or URL.
    recipe
        The pipeline.
    tolerance_s
        Largest distance between a step and its detection [s].
    truth
        File of truth instead of the recording's own.
    done_keys
        Keys of parts that need not be made again.
    folder
        What a path is relative to: workers may be started elsewhere.
    limit_s
        The most that it may take [s]; None: by the length of the recording, see `TimeLimit`.
    software
        What is to decide.
    made_by
        Host and process that gives tasks to workers.
    """

    location: Location
    recipe: Recipe
    tolerance_s: float = STEP_TOLERANCE_S
    truth: str | None = None
    done_keys: frozenset[str] = frozenset()
    folder: str = ""
    limit_s: float | None = None
    software: Software = Software()
    made_by: tuple[str, int] = ("", 0)

    @property
    def path(self) -> Path:
        """Where the recording lies; of a URL its public part."""
        return Path("" if is_url(self.location) else self.folder, self.location)


@dataclass(frozen=True, slots=True)
class Done:
    """What came of a task.

    Attributes
    ----------
    key
        Of its part.
    data
        The part; None where it was known.
    failed
        Whether it is an error.
    """

    key: str
    data: bytes | None = None
    failed: bool = False


def recipes_of(
    names: Sequence[str], settings: Sequence[str], tolerance_s: float
) -> tuple[Recipe, ...]:
    """Return the pipelines of some names or files; without any, what fits each recording.

    Raises
    ------
    PipelineError, PluginError
        Where one is no pipeline, or two have one name.
    """
    configs = [with_settings(load_pipeline(name), settings) for name in names]
    if not configs and settings:
        raise PipelineError("--set: expected --pipeline NAME to set it in, found none")
    pipeline_names = [config.name for config in configs]
    shipped = named_pipelines()
    for index, name in enumerate(names):  # a printed pipeline, changed, is known by its file
        if pipeline_names.count(configs[index].name) > 1 and name not in shipped:
            configs[index] = replace(configs[index], name=Path(name).stem)
    pipeline_names = [config.name for config in configs]
    twice = next((name for name in pipeline_names if pipeline_names.count(name) > 1), None)
    if twice is not None:
        raise PipelineError(f"--pipeline: expected different names, found {twice!r} twice")
    recipes = [(c.name, build_pipeline(c).recipe(), owners_of(c)) for c in configs]
    return tuple(
        Recipe(name, toml, recipe_sha256(toml, owners, tolerance_s), owners)
        for name, toml, owners in recipes or [(FITTING, "", ())]
    )


def recipe_sha256(toml: str, owners: Sequence[str], tolerance_s: float) -> str:
    """Return the hash of all that decides, but for the recording and its truth."""
    versions = sorted(package_versions().items())
    return _sha256(msgspec.json.encode((FORMAT, toml, versions, sorted(owners), tolerance_s)))


def owners_of(config: PipelineConfig) -> tuple[str, ...]:
    """Return name and version of the packages that bring a pipeline's plugins."""
    used = {stage.use for stage in config.stage}
    every = plugins("stages")
    return tuple({f"{p.distribution} {p.version}" for p in every if p.name in used})


@dataclass(frozen=True, slots=True)
class Identity:
    """What tells a task from all others, and what finding it out has opened.

    Attributes
    ----------
    key
        Of the task's part: the recording's name, and a hash of all that decides.
    sha256, bytes
        Of a local recording; empty and 0 where it cannot be read.
    remote
        The bytes of a remote one, which is known by its size and its end: its hash costs reading
        all of it.
    error
        Why a remote one cannot be reached.
    """

    key: str
    sha256: str = ""
    bytes: int = 0
    remote: RemoteBytes | None = None
    error: str = ""


def identity_of(task: Task) -> Identity:
    """Find out what a task is about, by the bytes of its recording and of its truth."""
    if not is_url(task.location):
        path = task.path
        try:
            content, size = file_sha256(path), path.stat().st_size
        except OSError:  # is told when it is opened
            content, size = "", 0
        return Identity(_key(task, content), content, size)
    try:
        remote = RemoteBytes(task.location)
        end = remote.read_at(max(0, remote.size - _END_BYTES), _END_BYTES)
    except CodecError as error:
        return Identity(_key(task, ""), error=error_text(task, error))
    return Identity(_key(task, f"{remote.size} {_sha256(end)}"), "", remote.size, remote)


def _key(task: Task, content: str) -> str:
    key_parts = (
        name_of(task.location),
        content,
        _truth_content(task),
        task.recipe.sha256,
        task.software.code,
    )
    return f"{name_part(task.location)}-{_sha256(msgspec.json.encode(key_parts))[:32]}"


def name_part(location: Location) -> str:
    """Return what the keys of a recording begin with."""
    return file_part(name_of(location))[:80]


def error_text(task: Task, error: Exception) -> str:
    """Return an error without the folder of its recording: the same wherever that lies."""
    return without_secrets(str(error)).replace(task.location, name_of(task.location))


def _truth_content(task: Task) -> tuple[str, ...]:
    """Return hashes of the files that may be truth: the one given, annotations beside."""
    files = [Path(task.truth)] if task.truth is not None else []
    if not is_url(task.location):
        beside = sidecar_path(task.path)
        files += [beside, journal_of(beside)]
    return tuple(_file_content(path) for path in files)


def _file_content(path: Path) -> str:
    try:
        return file_sha256(path)
    except OSError:
        return ""


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


#: The parts of the packages that say what is found in a recording, and how well.
_DECIDING = (
    "groundtrace_codecs",
    *(
        f"groundtrace.{part}"
        for part in (
            "annotate", "api", "detectors", "dsp", "evaluation", "explain", "fleet", "inertial",
            "kernels", "localizers", "pipeline", "trackers", "vehicles",
        )
    ),
)  # fmt: skip


@cache
def code_sha256() -> str:
    """Return the hash of the installed code that decides."""
    digest = hashlib.sha256()
    for package in _DECIDING:
        (folder,) = importlib.import_module(package).__path__
        for path in sorted(Path(folder).rglob("*.py")):
            digest.update(path.relative_to(folder).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


@cache
def misfit(software: Software) -> str:
    """Return in what this process decides with other software, or nothing."""
    here = {name: f"{name} {number}" for name, number in package_versions().items()}
    for wanted in software.versions:
        installed = here.get(wanted.partition(" ")[0], "none")
        if installed != wanted:
            return f"expected {wanted}, found {installed}"
    brought = (
        {f"{p.distribution} {p.version}" for p in plugins("stages")} if software.owners else ()
    )
    for wanted in software.owners:
        if wanted not in brought:
            return f"expected {wanted}, which has plugins, found none"
    if software.code and software.code != code_sha256():
        installed = f"groundtrace {installed_version()} with code {code_sha256()[:12]}"
        return f"expected the code of this run, {software.code[:12]}, found {installed}"
    return ""


def check_software(software: Software) -> None:
    """Check that this process decides with the software of a run.

    Raises
    ------
    MisfitError
        Where it does not.
    """
    if wrong := misfit(software):
        raise MisfitError(f"{platform.node()}: {wrong}")


@dataclass(frozen=True, slots=True)
class Replayed:
    """A recording that was replayed.

    Attributes
    ----------
    events
        All of them.
    samples
        How many samples went through.
    damage
        What was left out of the recording.
    """

    events: tuple[Event, ...]
    samples: int
    damage: Collection[Damage]


def in_one_go(_: Task, opened: Recording, ready: Prepared) -> Replayed:
    """Replay a recording from its begin to its end, in this process."""
    sink = EventList()
    items = with_warnings(Source(opened, bridge_s=ready.chain.bridge_s), ready.looked_at)
    tally = replay(itertools.chain(ready.notes, items), ready.chain, [sink])
    return Replayed(tuple(sink.events), tally.samples, opened.damage)


def evaluate(
    task: Task, replays: Callable[[Task, Recording, Prepared], Replayed] = in_one_go
) -> Done:
    """Replay, score and explain; whatever goes wrong becomes the row's error.

    Parameters
    ----------
    task
        What to do.
    replays
        Replays the recording.

    Raises
    ------
    MisfitError
        Where this process decides with other software than the run has.
    """
    check_software(task.software)
    began = time.perf_counter()
    limit = TimeLimit(task)
    identity = Identity("")
    try:
        with limit:
            identity = identity_of(task)
            if identity.key in task.done_keys:
                return Done(identity.key)
            part = _part(task, first_row(task, identity), identity, limit, replays)
            sha256 = part.row.sha256 if identity.remote is None else identity.remote.sha256()
    except TimeLimitError:
        message = (
            f"{name_of(task.location)}: expected a replay within {limit.limit_s:g} s, found none"
        )
    except (CodecError, GroundtraceError) as error:
        message = error_text(task, error)
    except OSError as error:
        message = (
            f"{name_of(task.location)}: expected a file to use, found: {error.strerror or error}"
        )
    except Exception as error:  # a bug costs its recording, and is told; the fleet goes on
        message = _place_of(error)
    else:
        done = replace(part.row, sha256=sha256, wall_s=time.perf_counter() - began)
        return Done(identity.key, replace(part, row=done).encoded())
    return _failed(task, identity, message, time.perf_counter() - began)


def _failed(task: Task, identity: Identity, message: str, wall_s: float = 0.0) -> Done:
    """Return what came of a task that failed; without a key it is that of bytes nobody has read."""
    identity = identity if identity.key else Identity(_key(task, ""))
    row = replace(first_row(task, identity), wall_s=wall_s)
    return Done(identity.key, failed(row, message).encoded(), failed=True)


def lost(task: Task) -> Done:
    """Return what came of a task whose workers were killed, twice.

    The bytes of a remote recording are not asked for: it may be these that come to no end.
    """
    identity = Identity("") if is_url(task.location) else identity_of(task)
    return _failed(task, identity, f"{name_of(task.location)}: {NEVER_ENDED}")


#: What is said where workers did not live to give an answer.
NEVER_ENDED = "expected a worker that ends, found it killed twice, or overdue"


def invisible(host: str) -> str:
    """Return what is said where a worker does not see a recording."""
    return f"expected a file, found none visible on worker {host}"


#: The most that a recording may take: so many times its length, and at least so long [s]. Chosen by
#: judgement: replays run at hundreds of times real time; what takes longer hangs.
LIMIT_RATIO, LEAST_LIMIT_S = 50.0, 600.0
#: A worker that does not heed its limit ends itself after this time [s]: it is held up in code that
#: hears nothing. Chosen by judgement.
_GRACE_S = 30.0
#: While these load or compile, a worker is not broken off: half a module would stay behind, and
#: fail all recordings after this one. It is looked again after this time [s]; what loads for longer
#: than LEAST_LIMIT_S hangs. Chosen by judgement.
_LOADERS, _LOOK_S = ("importlib", "numba", "llvmlite"), 0.2


class TimeLimitError(BaseException):
    """A recording took longer than it may: no damage or failed request to be borne with."""


class TimeLimit:
    """Breaks off what this thread does after some time, and ends the worker if that is of no use.

    Where code is being loaded or compiled then, the time begins anew after that: it is the first
    recording of the worker, and what takes long is no fault of its own.

    Parameters
    ----------
    task
        Its limit, or None: then `LEAST_LIMIT_S`, until the length of the recording is known.
    """

    def __init__(self, task: Task) -> None:
        self._task = task
        self._thread = threading.get_ident()
        self._timer: threading.Timer | None = None
        self._ending = threading.Lock()
        self._over = False
        self._loaded_s, self._loading = 0.0, False
        self.limit_s = LEAST_LIMIT_S if task.limit_s is None else task.limit_s

    def __enter__(self) -> Self:
        self._wait(self.limit_s, self._break)
        return self

    def __exit__(self, *_: object) -> None:
        with self._ending:
            self._over = True
            self._stop()
            self._raise(None)  # what was raised and has not come yet

    def of_length(self, length_s: float) -> None:
        """Take the length of the recording into account."""
        if self._task.limit_s is None and LIMIT_RATIO * length_s > LEAST_LIMIT_S:
            self.limit_s = LIMIT_RATIO * length_s
            self._wait(self.limit_s, self._break)

    def _wait(self, wait_s: float, then: Callable[[], None]) -> None:
        self._stop()
        self._timer = threading.Timer(wait_s, then)
        self._timer.daemon = True
        self._timer.start()

    def _stop(self) -> None:
        if self._timer is not None:
            self._timer.cancel()

    def _break(self) -> None:
        with self._ending:
            if self._over:
                return
            if self._loaded_s < LEAST_LIMIT_S and _loads(self._thread):
                self._loaded_s += _LOOK_S
                self._loading = True
                self._wait(_LOOK_S, self._break)
                return
            if self._loading:  # no more: it begins anew
                self._loading = False
                self._wait(self.limit_s, self._break)
                return
            self._raise(TimeLimitError)
            if self._task.made_by != (platform.node(), os.getpid()):  # a worker, not the run itself
                self._wait(_GRACE_S, lambda: os._exit(OVERDUE))

    def _raise(self, error: type[BaseException] | None) -> None:
        """Let this thread raise an error as soon as it can; None takes it back."""
        raised = ctypes.py_object() if error is None else ctypes.py_object(error)
        ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(self._thread), raised)


def _loads(thread: int) -> bool:
    """Return whether a thread is loading modules or compiling."""
    frame = sys._current_frames().get(thread)
    while frame is not None:
        if str(frame.f_globals.get("__name__", "")).partition(".")[0] in _LOADERS:
            return True
        frame = frame.f_back
    return False


def first_row(task: Task, identity: Identity) -> Row:
    """Return what is known of a task before its recording is opened."""
    return Row(
        name_of(task.location),
        task.recipe.name,
        task.recipe.sha256,
        identity.sha256,
        identity.bytes,
        tolerance_s=task.tolerance_s,
        versions=", ".join(f"{name} {number}" for name, number in package_versions().items()),
        host=platform.node(),
    )


def _place_of(error: Exception) -> str:
    """Return an error that nobody expected, with the line of code it is from."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    at = "" if trace is None else f" ({Path(trace.tb_frame.f_code.co_filename).name}"
    line = "" if trace is None else f":{trace.tb_lineno})"
    return f"{type(error).__name__}: {error}{at}{line}"


def _part(
    task: Task,
    row: Row,
    identity: Identity,
    limit: TimeLimit,
    replays: Callable[[Task, Recording, Prepared], Replayed],
) -> Part:
    """Replay a recording and return all that is said about it."""
    if identity.error:
        raise RecordingError(identity.error)
    remote = identity.remote
    if remote is None and not task.path.is_file():
        raise RecordingError(f"{row.recording}: {invisible(row.host)}")
    with Recording.open(remote or task.path) as opened:
        limit.of_length((opened.end_ns - opened.start_ns) / NS_PER_S)
        if RUN in opened.metadata:
            raise RecordingError(f"{opened.name}: expected a recording, found results of one")
        labels, row = _with_truth(task, row, opened)
        ready = ready_for(task, opened)
        replayed = replays(task, opened, ready)
        if not replayed.samples:
            raise RecordingError(f"{opened.name}: expected signals to replay, found none")
        asked = build_pipeline(ready.asked, opened.geometry, opened.labels)
        row = replace(
            row,
            pipeline=asked.config.name,
            pipeline_sha256=task.recipe.sha256 if task.recipe.toml else _sha256_of(asked, row),
            parameters=asked.recipe(),
            start_ns=opened.start_ns,
            duration_s=(opened.end_ns - opened.start_ns) / NS_PER_S,
            topics=", ".join(s.topic for s in opened.streams),
            channels=sum(len(s.channels) for s in opened.streams),
            samples=replayed.samples,
            damaged_places=len(replayed.damage),
            lost_messages=sum(d.messages or 0 for d in replayed.damage),
            subject=_stated(opened, "subject"),
            site=_stated(opened, "site"),
        )
        origin = Provenance(row.recording, row.sha256, opened.start_ns, opened.end_ns, "")
        placements = {s.topic: s.placement for s in opened.streams if s.placement}
        origin = replace(origin, pipeline=ready.chain.recipe(), placements=placements)
        given = given_to(origin.pipeline, opened.labels)
        result = Results(
            row.recording, origin, labels, opened.geometry, replayed.events, given=given
        )
        result = replace(result, labels=scored_truth(labels, result).labels)
    return _judged(row, result, remote or task.path)


def _stated(opened: Recording, key: str) -> str:
    """Return what metadata of a recording say under a key, whatever their record is called."""
    pairs = (pair for values in opened.metadata.values() for pair in values.items())
    texts = {value.strip() for name, value in pairs if name.lower() == key and value.strip()}
    return "; ".join(sorted(texts))


def _with_truth(task: Task, row: Row, opened: Recording) -> tuple[tuple[Label, ...], Row]:
    truth = None if task.truth is None else Path(task.truth)
    # remarks on one recording say nothing in a fleet
    labels = truth_of_recording(opened, task.path, truth)
    source = "recording" if opened.labels else "annotations" if labels else ""
    source = truth.name if truth is not None else source
    return labels, replace(row, truth=source, labels=len(labels))


def ready_for(task: Task, opened: Recording) -> Prepared:
    """Return the pipeline of a task, ready for its recording."""
    toml = task.recipe.toml
    config = (
        parse_pipeline(toml.encode(), task.recipe.name)
        if toml
        else load_pipeline(default_pipeline(opened))
    )
    return prepared(config, opened)


def _sha256_of(chain: Pipeline, row: Row) -> str:
    """Return the hash that a pipeline has where it is asked for by name."""
    return recipe_sha256(chain.recipe(), owners_of(chain.config), row.tolerance_s)


def _judged(row: Row, result: Results, source: ByteSource | Path) -> Part:
    """Score and explain a result."""
    answers = answers_of(result.events)
    gaps = [e for e in result.events if isinstance(e, Gap)]
    origin = result.provenance
    score = score_events(
        result.labels, result.events, origin.start_ns, origin.end_ns, row.tolerance_s
    )
    steps = _steps(result, row.tolerance_s, source) if score.steps is not None else ()
    causes: dict[str, int] = {}
    for step in steps:
        if step.cause:
            causes[step.cause] = causes.get(step.cause, 0) + 1
    row = replace(
        row,
        gaps=sum(not g.bridged for g in gaps),
        lost_samples=sum(g.lost for g in gaps),
        found_steps=len(answers.steps),
        found_picks=len(answers.picks),
        found_fixes=len(answers.fixes),
        found_passes=len(answers.passes),
        warnings=" | ".join(warned.line for warned in result.warnings),
        figures={figure.name: _plain(figure.of(score)) for figure in FIGURES},
        causes=dict(sorted(causes.items())),
        score_json=_json(score, result.warnings),
    )
    return Part(row, steps)


def _steps(result: Results, tolerance_s: float, source: ByteSource | Path) -> tuple[StepRow, ...]:
    """Return every scored step and what became of it, by time."""
    evidence = evidence_of(result)
    signal = Unfiltered(evidence.config, lambda: source)
    reasons = StepReasons(replace(evidence, unfiltered=signal), tolerance_s)
    matching = reasons.matching
    truth, detected = matching.truth_ns.tolist(), matching.found_ns.tolist()
    rows = [
        StepRow("matched", int(t) + 1, None, truth[t], detected[f])
        for t, f in matching.pairs.tolist()
    ]
    for found_ns in matching.found_ns[matching.false].tolist():
        pair = reasons.wrong_time(found_ns)
        rows.append(StepRow("false", found_ns=found_ns, text="" if pair is None else pair.text))
    for number, index in enumerate(matching.missed.tolist(), 1):
        why, late = reasons.at(truth[index]), reasons.pair_of(truth[index])
        found_ns = None if late is None else late.found_ns
        missed = StepRow("missed", index + 1, number, truth[index], found_ns)
        rows.append(replace(missed, cause=why.cause, gate=why.gate, text=why.text))
    return tuple(sorted(rows, key=lambda row: (row.time_ns, row.verdict)))


def _json(score: Score, warnings: Sequence[Warned]) -> str:
    """Return a score as ``groundtrace score --json`` gives it, without parts that are None."""
    parts = msgspec.to_builtins(score, enc_hook=str)
    document = {k: v for k, v in parts.items() if v is not None}
    document["warnings"] = [warned.document for warned in warnings]
    return msgspec.json.encode(document).decode()


def _plain(value: Any) -> Any:
    """Return a number of numpy as one of Python."""
    return value.item() if hasattr(value, "item") else value


#: Files that lie beside recordings and are none, though they are MCAP too.
_BESIDE = (".annotations.mcap", ".results.mcap")
_PATTERN = re.compile(r"[*?\[]")
TRUTH_SUFFIXES = (".csv", ".truth.csv", ".sgt", ".annotations.mcap", ".mcap")


def recordings_of(arguments: Sequence[str]) -> list[Location]:
    """Return every recording that the arguments mean, sorted, each once.

    Parameters
    ----------
    arguments
        Files, folders (with all below them), patterns as the shell knows them, URLs of those.

    Raises
    ------
    RecordingError
        Where an argument means none.
    CodecError
        Where a URL cannot be listed.
    """
    locations: set[Location] = set()
    for argument in arguments:
        places = _remote(argument) if is_url(argument) else _local(argument)
        if not places:
            raise RecordingError(
                f"{argument}: expected a recording, a folder of recordings or a pattern, found none"
            )
        locations.update(places)
    if not locations:
        raise RecordingError("fleet: expected recordings, found none")
    return sorted(locations)


def name_of(location: Location) -> str:
    """Return the file name of a recording."""
    return PurePosixPath(location).name if is_url(location) else Path(location).name


def shard_of(text: str) -> tuple[int, int]:
    """Read ``I/N``: the shard I of N, from 1.

    Raises
    ------
    RecordingError
        Where it is not that.
    """
    index, slash, count = text.partition("/")
    if slash and index.isdecimal() and count.isdecimal() and 1 <= int(index) <= int(count):
        return int(index), int(count)
    raise RecordingError(f"--shard: expected I/N with I from 1 to N, found {text!r}")


def truth_beside(truth: Path | None, locations: Sequence[Location]) -> dict[Location, Path]:
    """Return the file of truth of each recording that has one.

    Parameters
    ----------
    truth
        A file, for one recording, or a folder with files named as the recordings are: ``walk.csv``
        or ``walk.truth.csv`` for ``walk.mcap``.
    locations
        The recordings.

    Raises
    ------
    RecordingError
        Where it is neither, or one file is given for several recordings.
    """
    if truth is None:
        return {}
    if truth.is_dir():
        named = {
            location: _named(truth, PurePosixPath(name_of(location)).stem) for location in locations
        }
        return {location: path for location, path in named.items() if path is not None}
    if not truth.is_file():
        raise RecordingError(f"{truth}: expected a truth file or folder, found none")
    if len(locations) > 1:
        raise RecordingError(
            f"--truth: expected a folder for {len(locations)} recordings, found the file {truth}"
        )
    return {locations[0]: truth}


def _named(folder: Path, stem: str) -> Path | None:
    files = (folder / f"{stem}{suffix}" for suffix in TRUTH_SUFFIXES)
    return next((path for path in files if path.is_file()), None)


def _local(argument: str) -> list[Location]:
    path = Path(argument)
    if path.is_dir():
        below = (p for p in path.rglob("*.mcap") if p.is_file())
        return [Location(p) for p in below if _is_recording(p.name)]
    if path.is_file() or not _PATTERN.search(argument):
        return [Location(path)] if path.is_file() else []
    matched = (Path(p) for p in glob.glob(argument, recursive=True))  # noqa: PTH207  # absolute too
    return [Location(p) for p in matched if p.is_file() and _is_recording(p.name)]


def _remote(argument: str) -> list[Location]:
    url = Location(argument)
    pattern = _PATTERN.search(url.partition("://")[2])
    if not pattern and (url.startswith("http") or url.endswith(".mcap")):
        return [url]
    system, path = file_system(url)
    listed = system.glob(path) if pattern else system.find(path)
    return [Location(system.unstrip_protocol(p)) for p in listed if _is_recording(p)]


def _is_recording(name: str) -> bool:
    return name.endswith(".mcap") and not name.endswith(_BESIDE)
