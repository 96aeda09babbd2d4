"""Engines that compute a fleet's tasks. Each gives the same results, in another order.

An engine has a crew: the workers of this computer, of a Dask cluster or of a Ray cluster. One loop
gives tasks to the workers of any crew, one by one, so that it knows whose fault it is where one
ends. Dask and Ray are imported by their crews: importing them costs seconds.
"""

from __future__ import annotations

import logging
import os
import queue
import signal
import socket
import sys
import threading
import time
from collections import Counter, deque
from contextlib import ExitStack, chdir, contextmanager, redirect_stdout, suppress
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from multiprocessing import get_context
from multiprocessing.connection import wait
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from groundtrace_codecs.errors import MissingReaderError

from ..errors import GroundtraceError, RecordingError
from ..runtime import limit_blas_threads, raise_malloc_trim, safe_path
from ..scratch import scratch_folder

if TYPE_CHECKING:
    from collections.abc import (
        Callable,
        Collection,
        Generator,
        Iterable,
        Iterator,
        Mapping,
        Sequence,
    )
    from contextlib import AbstractContextManager
    from multiprocessing.connection import Connection
    from multiprocessing.context import SpawnProcess

T = TypeVar("T")
R = TypeVar("R")

#: What a worker exits with that ended itself because its task did not end in time. Chosen by
#: judgement: no code that Python or a shell uses.
OVERDUE = 99
#: A cluster that does not answer within this time is not there [s]. Chosen by judgement.
REACHED_S = 10.0
#: How long a cluster may be without a worker [s]. Chosen by judgement: workers that are being
#: started come within it.
WORKERS_S = 60.0
#: How often it is looked which workers there are [s]. Chosen by judgement.
_LOOK_S = 1.0
#: How often a task may lose its worker. Chosen by judgement: a worker that is lost twice at one
#: task is lost by it.
_TRIES = 2


class MisfitError(GroundtraceError):
    """A worker is not one of this run: it has other code, or other versions."""


class WorkerLostError(Exception):
    """A worker was killed, or ended itself because its task was overdue."""

    def __init__(self, *, overdue: bool = False) -> None:
        super().__init__()
        self.overdue = overdue


class Crew(Protocol):
    """The workers of an engine."""

    def there(self, wanted: int) -> Mapping[str, int]:
        """Return how many tasks each worker does at once, by its name.

        Parameters
        ----------
        wanted
            How many tasks there are still to do: more workers need not be started.

        Raises
        ------
        RecordingError
            Where the cluster is not reached any more.
        """

    def give(self, worker: str, function: Callable[[T], R], task: T) -> Any:
        """Give a worker a task, and return what stands for its answer: hashable."""

    def ended(self, given: Collection[Any], wait_s: float) -> Iterable[Any]:
        """Return which of the answers are there; wait so long for the first [s]."""

    def answer(self, given: Any) -> Any:
        """Return an answer that is there.

        Raises
        ------
        WorkerLostError
            Where the worker was lost.
        Exception
            What the function raised.
        """


@dataclass(frozen=True, slots=True)
class Engine:
    """Calls a function for many tasks, in other processes.

    Attributes
    ----------
    name
        As it was asked for.
    crew
        Opens the crew, and ends what it started.
    """

    name: str
    crew: Callable[[], AbstractContextManager[Crew]]

    def run(
        self,
        function: Callable[[T], R],
        tasks: Sequence[T],
        left_out: Callable[[str], None] = lambda _: None,
    ) -> Generator[tuple[int, R | None]]:
        """Yield the number of each task and what the function gave, in the order they end.

        None stands for a task whose worker was killed, and that of a second try too, or did not
        end in time. A worker on which the function raises is given no task any more, and others do
        what it was to do. Closing the iterator ends what still runs.

        Parameters
        ----------
        function, tasks
            What is called, with each task.
        left_out
            Is told which worker gets none, and why.

        Raises
        ------
        RecordingError
            Where a cluster is not reached, or has no worker that can do the tasks.
        """
        with self.crew() as crew:
            yield from _Shift(self.name, crew, function, tasks, left_out).answers()


def engine_of(text: str, workers: int) -> Engine:
    """Return an engine by ``local``, ``dask``, ``dask:ADDRESS``, ``ray`` or ``ray:ADDRESS``.

    Parameters
    ----------
    text
        Which one, and the address of a cluster there is already.
    workers
        Processes to start, where there is none.

    Raises
    ------
    RecordingError
        Where there is no such engine.
    MissingReaderError
        Where its package is not installed.
    """
    name, _, address = text.partition(":")
    if name == "local" and not address:
        return Engine(text, partial(local_crew, workers))
    for engine, package, extra, crew in (
        ("dask", "distributed", "fleet", dask_crew),
        ("ray", "ray", "ray", ray_crew),
    ):
        if name == engine:
            if find_spec(package) is None:
                raise MissingReaderError(f"--engine {package}", package, extra)
            return Engine(text, partial(crew, address, workers))
    raise RecordingError(
        f"--engine: expected local, dask, dask:ADDRESS, ray or ray:ADDRESS, found {text!r}"
    )


class _Shift:
    """Gives the tasks of one run to the workers of a crew, and yields what comes of them.

    Parameters
    ----------
    name, crew
        Of the engine.
    function, tasks, left_out
        As those of `Engine.run`.
    """

    def __init__(
        self,
        name: str,
        crew: Crew,
        function: Callable[[Any], Any],
        tasks: Sequence[Any],
        left_out: Callable[[str], None],
    ) -> None:
        self._name, self._crew = name, crew
        self._function, self._tasks = function, tasks
        self._left_out = left_out
        self._waiting = deque(range(len(tasks)))
        self._losses: Counter[int] = Counter()
        self._given: dict[Any, tuple[str, int]] = {}
        self._out: dict[str, str] = {}  # why, by worker
        self._alone_since: float | None = None

    def answers(self) -> Iterator[tuple[int, Any]]:
        """Yield the number of each task and its answer."""
        while self._waiting or self._given:
            there = self._crew.there(len(self._waiting) + len(self._given))
            for given, (worker, number) in list(self._given.items()):
                if worker not in there:  # nobody will answer
                    del self._given[given]
                    yield from self._lost(number)
            self._give(there)
            for given in self._crew.ended(self._given, _LOOK_S) if self._given else ():
                worker, number = self._given.pop(given)
                try:
                    answer = self._crew.answer(given)
                except WorkerLostError as error:
                    yield from self._lost(number, overdue=error.overdue)
                except Exception as error:  # whatever it is: the tasks themselves raise nothing
                    self._leave_out(worker, error)
                    self._waiting.append(number)
                else:
                    yield number, answer

    def _give(self, there: Mapping[str, int]) -> None:
        """Give every worker as many tasks as it does at once; one that lost its worker, alone."""
        free = {worker: room for worker, room in there.items() if worker not in self._out}
        self._expect(there, free)
        for worker, number in self._given.values():
            if worker in free:
                free[worker] -= there[worker] if self._losses[number] else 1
        for worker, room in free.items():
            left = room
            while self._waiting and left > 0:
                number = self._waiting[0]
                if self._losses[number] and left < there[worker]:
                    break
                self._waiting.popleft()
                given = self._crew.give(worker, self._function, self._tasks[number])
                self._given[given] = (worker, number)
                left -= there[worker] if self._losses[number] else 1

    def _expect(self, there: Mapping[str, int], free: Mapping[str, int]) -> None:
        """Wait a little where no worker can do a task.

        Raises
        ------
        RecordingError
            Where that will not change, or has not for some time.
        """
        now = time.monotonic()
        if free or self._given:
            self._alone_since = None
            return
        if there:
            worker, why = next(iter(self._out.items()))
            left_out = f"{len(self._out)} left out, the first, {worker}: {why}"
            raise RecordingError(
                f"--engine {self._name}: expected a worker to use, found {left_out}"
            )
        self._alone_since = now if self._alone_since is None else self._alone_since
        if now - self._alone_since >= WORKERS_S:
            problem = f"expected a worker within {WORKERS_S:g} s, found none"
            raise RecordingError(f"--engine {self._name}: {problem}")
        time.sleep(_LOOK_S)

    def _leave_out(self, worker: str, error: Exception) -> None:
        if worker not in self._out:
            lines = str(error).strip().splitlines()
            what = f"{type(error).__name__}: {lines[-1] if lines else ''}"
            fit = isinstance(error, MisfitError)
            self._out[worker] = str(error) if fit else f"expected an answer, found: {what}"
            self._left_out(f"worker {worker} is left out: {self._out[worker]}")

    def _lost(self, number: int, *, overdue: bool = False) -> Iterator[tuple[int, None]]:
        self._losses[number] += 1
        if self._losses[number] < _TRIES and not overdue:
            self._waiting.append(number)
        else:
            yield number, None


@dataclass(slots=True)
class _Process:
    """A worker of this computer, and the pipe to it."""

    process: SpawnProcess
    pipe: Any  # a connection, of a type of its own on Windows


class LocalCrew:
    """Processes of this computer.

    A process that is killed, by a person or for want of memory, costs only the task it had: with a
    pool of the standard library it would break the pool, and not be known whose fault it was.

    Parameters
    ----------
    size
        How many processes.
    """

    def __init__(self, size: int) -> None:
        self._size = size
        self._processes: dict[str, _Process] = {}

    def there(self, wanted: int) -> Mapping[str, int]:
        """Return the processes, after starting those that are wanted."""
        while len(self._processes) < min(self._size, wanted):
            worker = _start()
            self._processes[f"process {worker.process.pid}"] = worker
        return dict.fromkeys(self._processes, 1)

    def give(self, worker: str, function: Callable[[T], R], task: T) -> Any:
        """Give a process a task; its pipe stands for the answer."""
        pipe = self._processes[worker].pipe
        with suppress(OSError):  # killed while it was idle: found out when its answer is read
            pipe.send((function, task))
        return pipe

    def ended(self, given: Collection[Any], wait_s: float) -> Iterable[Any]:
        """Return the pipes in which there is an answer, or an end."""
        return wait(list(given), wait_s)

    def answer(self, given: Any) -> Any:
        """Return what a process answered."""
        try:
            good, answer = given.recv()
        except (EOFError, OSError):  # killed: its end of the pipe is closed
            name = next(n for n, worker in self._processes.items() if worker.pipe is given)
            overdue = _end(self._processes.pop(name)) == OVERDUE
            raise WorkerLostError(overdue=overdue) from None
        if not good:
            raise answer
        return answer

    def end(self) -> None:
        """End all processes."""
        for worker in self._processes.values():
            _end(worker)


@contextmanager
def local_crew(size: int) -> Iterator[LocalCrew]:
    """Open a crew of so many processes, which end with it."""
    crew = LocalCrew(size)
    try:
        yield crew
    finally:
        crew.end()


def _start() -> _Process:
    context = get_context("spawn")
    here, there = context.Pipe()
    with quiet():
        process = context.Process(target=_serve, args=(there,), daemon=True)
        process.start()
    there.close()
    return _Process(process, here)


def _serve(pipe: Connection[Any, Any]) -> None:
    """Answer tasks until the other end is closed."""
    raise_malloc_trim()
    # at the end it remarks on requests that a time limit broke off
    logging.getLogger("asyncio").setLevel(logging.CRITICAL)
    while True:
        try:
            function, task = pipe.recv()
        except (EOFError, OSError):
            return
        try:
            answer = True, function(task)
        except Exception as error:  # for the other end to judge
            answer = False, error
        pipe.send(answer)


def _end(worker: _Process) -> int | None:
    """End a worker; return what it exited with, if it had by itself."""
    worker.pipe.close()
    worker.process.join(0.1)
    code = worker.process.exitcode
    worker.process.kill()
    worker.process.join()
    worker.process.close()
    return code


class DaskCrew:
    """The workers of a Dask cluster; what they answer comes back over the network.

    Parameters
    ----------
    name
        Of the engine.
    client
        Of the cluster.
    """

    def __init__(self, name: str, client: Any) -> None:
        self._name, self._client = name, client
        self._ended: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._there = _Looked(self._look)

    def there(self, _: int) -> Mapping[str, int]:
        """Return the threads of each worker, by its address."""
        return self._there.now()

    def _look(self) -> Mapping[str, int]:
        with reached(self._name):
            return dict(self._client.nthreads(callback_timeout=REACHED_S))

    def give(self, worker: str, function: Callable[[T], R], task: T) -> Any:
        """Give a worker a task; a future stands for the answer."""
        future = self._client.submit(function, task, workers=[worker], pure=False)
        future.add_done_callback(self._ended.put)
        return future

    def ended(self, given: Collection[Any], wait_s: float) -> Iterable[Any]:
        """Return a future that has ended."""
        try:
            future = self._ended.get(timeout=wait_s)
        except queue.Empty:
            return ()
        return (future,) if future in given else ()  # else that of a worker that went away

    def answer(self, given: Any) -> Any:
        """Return what a worker answered."""
        from distributed.scheduler import KilledWorker

        if given.status == "finished":
            return given.result()
        if given.status == "cancelled" or isinstance(given.exception(), KilledWorker):
            raise WorkerLostError
        raise given.exception()


@contextmanager
def dask_crew(address: str, size: int) -> Iterator[DaskCrew]:
    """Open the crew of a Dask cluster.

    Parameters
    ----------
    address
        Of the scheduler, as ``tcp://HOST:8786``; a cluster of this computer is started where empty.
    size
        Processes of such a cluster.
    """
    distributed = import_module("distributed")
    name = f"dask:{address}" if address else "dask"
    with ExitStack() as stack:
        if address:
            with quiet(), reached(name):
                client = stack.enter_context(distributed.Client(address, timeout=REACHED_S))
        else:
            with quiet():
                cluster = distributed.LocalCluster(
                    n_workers=size,
                    threads_per_worker=1,
                    dashboard_address=":0",
                    silence_logs=logging.CRITICAL,
                )
            client = stack.enter_context(distributed.Client(stack.enter_context(cluster)))
        yield DaskCrew(name, client)


class RayCrew:
    """The nodes of a Ray cluster; what they answer comes back over the network.

    Parameters
    ----------
    name
        Of the engine.
    """

    def __init__(self, name: str) -> None:
        self._name, self._ray = name, import_module("ray")
        self._ids: dict[str, str] = {}
        self._there = _Looked(self._look)

    def there(self, _: int) -> Mapping[str, int]:
        """Return the processors of each node, by its address and the beginning of its id."""
        return self._there.now()

    def _look(self) -> Mapping[str, int]:
        with reached(self._name):
            nodes = [node for node in self._ray.nodes() if node["Alive"]]
        named = [(f"{n['NodeManagerAddress']} ({n['NodeID'][:8]})", n) for n in nodes]
        self._ids = {name: node["NodeID"] for name, node in named}
        room = {name: int(node["Resources"].get("CPU", 0)) for name, node in named}
        return {name: processors for name, processors in room.items() if processors}

    def give(self, worker: str, function: Callable[[T], R], task: T) -> Any:
        """Give a node a task; a reference stands for the answer."""
        strategies = import_module("ray.util.scheduling_strategies")
        there = strategies.NodeAffinitySchedulingStrategy(self._ids[worker], soft=False)
        remote = self._ray.remote(function).options(max_retries=0, scheduling_strategy=there)
        return remote.remote(task)

    def ended(self, given: Collection[Any], wait_s: float) -> Iterable[Any]:
        """Return a reference whose answer is there."""
        return tuple(self._ray.wait(list(given), num_returns=1, timeout=wait_s)[0])

    def answer(self, given: Any) -> Any:
        """Return what a node answered."""
        errors = self._ray.exceptions
        try:
            return self._ray.get(given)
        except errors.RayTaskError as error:
            raise error.cause from None
        except errors.RayError:  # its process, or the node, is not there any more
            raise WorkerLostError from None


@contextmanager
def ray_crew(address: str, size: int) -> Iterator[RayCrew]:
    """Open the crew of a Ray cluster.

    Parameters
    ----------
    address
        As ``ray://HOST:10001`` or ``auto``; a cluster of this computer is started where empty.
    size
        Processors of such a cluster.
    """
    ray = import_module("ray")
    name = f"ray:{address}" if address else "ray"
    # Ray prints on stdout that a worker was killed
    with scratch_folder() as empty, redirect_stdout(sys.stderr):
        # workers look for modules where this process is while it makes contact
        with chdir(empty), quiet():
            if address:
                with reached(name):
                    _listens(address)
                    ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR)
            else:
                os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # to the makers of Ray
                ray.init(
                    address="local",
                    num_cpus=size,
                    include_dashboard=False,
                    log_to_driver=False,
                    logging_level=logging.ERROR,
                )
        try:
            yield RayCrew(name)
        finally:
            ray.shutdown()


class _Looked:
    """What was seen when it was looked last, at most a second ago."""

    def __init__(self, look: Callable[[], Mapping[str, int]]) -> None:
        self._look, self._next = look, -1.0
        self._seen: Mapping[str, int] = {}

    def now(self) -> Mapping[str, int]:
        """Return what there is."""
        if time.monotonic() >= self._next:
            self._seen = self._look()
            self._next = time.monotonic() + _LOOK_S
        return self._seen


def _listens(address: str) -> None:
    """Raise where nobody listens at an address: the package tries for minutes."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if port.isdecimal():
        socket.create_connection((host, int(port)), REACHED_S).close()


@contextmanager
def reached(address: str) -> Iterator[None]:
    """Make what goes wrong while a cluster is looked for one line.

    Raises
    ------
    RecordingError
        Where it is not reached.
    """
    try:
        yield
    except (OSError, ValueError, RuntimeError, TypeError) as error:
        message = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise RecordingError(f"--engine {address}: expected a cluster, found: {message}") from error


@contextmanager
def quiet() -> Iterator[None]:
    """Let processes start with one thread of their own, deaf to Ctrl-C, which is ours to answer.

    They do not look for modules in the working folder.
    """
    unset = limit_blas_threads()
    ours = threading.current_thread() is threading.main_thread()
    before = signal.signal(signal.SIGINT, signal.SIG_IGN) if ours else None
    mask = None
    if sys.platform != "win32" and not ours and hasattr(signal, "pthread_sigmask"):
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        with safe_path():
            yield
    finally:
        if ours:
            signal.signal(signal.SIGINT, before)
        if sys.platform != "win32" and mask is not None:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for name in unset:
            del os.environ[name]
