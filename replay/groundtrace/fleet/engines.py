"""Engines that compute a fleet's tasks. Each gives the same results, in another order.

Dask and Ray are imported by the engines that they run: importing them costs seconds.
"""

from __future__ import annotations

import logging
import os
import signal
import socket
import threading
from collections import deque
from contextlib import ExitStack, chdir, contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from multiprocessing import get_context
from multiprocessing.connection import wait
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from groundtrace_codecs.errors import MissingReaderError

from ..errors import RecordingError
from ..runtime import limit_blas_threads, raise_malloc_trim, safe_path
from ..scratch import scratch_folder

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from multiprocessing.connection import Connection
    from multiprocessing.context import SpawnProcess

T = TypeVar("T")
R = TypeVar("R")


class Engine(Protocol):
    """Calls a function for many tasks, in other processes."""

    def run(self, function: Callable[[T], R], tasks: Sequence[T]) -> Iterator[tuple[int, R | None]]:
        """Yield the number of each task and what the function gave, in the order they end.

        None stands for a task whose worker was killed, and that of a second try too, or did not
        end in time. Closing the iterator ends what still runs.

        Raises
        ------
        RecordingError
            Where a cluster is not reached, or its workers are not of this run.
        """


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
        return LocalEngine(workers)
    for known, package, extra, engine in (
        ("dask", "distributed", "fleet", DaskEngine),
        ("ray", "ray", "ray", RayEngine),
    ):
        if name == known:
            if find_spec(package) is None:
                raise MissingReaderError(f"--engine {package}", package, extra)
            return engine(address, workers)
    raise RecordingError(
        f"--engine: expected local, dask, dask:ADDRESS, ray or ray:ADDRESS, found {text!r}"
    )


#: What a worker exits with that ended itself because its task did not end in time. Chosen by
#: judgement: no code that Python or a shell uses.
OVERDUE = 99
#: A cluster that does not answer within this time is not there [s]. Chosen by judgement.
REACHED_S = 10.0
#: How often a task may lose its worker. Chosen by judgement: a worker that is lost twice at one
#: task is lost by it.
_TRIES = 2


@dataclass(slots=True)
class _Worker:
    """A process, the pipe to it, and the number of the task it has."""

    process: SpawnProcess
    pipe: Any  # a connection, of a type of its own on Windows
    task: int = -1


class LocalEngine:
    """Runs tasks in processes of this computer.

    A process that is killed, by a person or for want of memory, costs only the task it had: with a
    pool of the standard library it would break the pool, and not be known whose fault it was.

    Parameters
    ----------
    workers
        How many processes.
    """

    def __init__(self, workers: int) -> None:
        self.workers = workers

    def run(self, function: Callable[[T], R], tasks: Sequence[T]) -> Iterator[tuple[int, R | None]]:
        """Yield the number of each task and its result; None where two workers were killed."""
        waiting = deque(range(len(tasks)))
        losses = [0] * len(tasks)
        busy: dict[Any, _Worker] = {}
        idle: list[_Worker] = []
        try:
            while waiting or busy:
                while waiting and len(busy) < self.workers:
                    worker = idle.pop() if idle else _start(function)
                    _give(worker, waiting, tasks)
                    busy[worker.pipe] = worker
                for pipe in wait(list(busy)):
                    worker = busy.pop(pipe)
                    try:
                        result = worker.pipe.recv()
                    except (EOFError, OSError):  # killed: its end of the pipe is closed
                        overdue = _end(worker) == OVERDUE
                        losses[worker.task] += 1
                        if losses[worker.task] < _TRIES and not overdue:
                            waiting.append(worker.task)
                        else:
                            yield worker.task, None
                        continue
                    idle.append(worker)
                    yield worker.task, result
        finally:
            for worker in (*idle, *busy.values()):
                _end(worker)


def _give(worker: _Worker, waiting: deque[int], tasks: Sequence[Any]) -> None:
    worker.task = waiting.popleft()
    try:
        worker.pipe.send(tasks[worker.task])
    except OSError:  # killed while it was idle: found out when its answer is read
        return


def _start(function: Callable[[Any], Any]) -> _Worker:
    context = get_context("spawn")
    here, there = context.Pipe()
    with quiet():
        process = context.Process(target=_serve, args=(there, function), daemon=True)
        process.start()
    there.close()
    return _Worker(process, here)


def _serve(pipe: Connection[Any, Any], function: Callable[[Any], Any]) -> None:
    """Answer tasks until the other end is closed."""
    raise_malloc_trim()
    while True:
        try:
            task = pipe.recv()
        except (EOFError, OSError):
            return
        pipe.send(function(task))


def _end(worker: _Worker) -> int | None:
    """End a worker; return what it exited with, if it had by itself."""
    worker.pipe.close()
    worker.process.join(0.1)
    code = worker.process.exitcode
    worker.process.kill()
    worker.process.join()
    worker.process.close()
    return code


class DaskEngine:
    """Runs tasks on a Dask cluster; what they give comes back over the network.

    Parameters
    ----------
    address
        Of the scheduler, as ``tcp://HOST:8786``; a cluster of this computer is started where empty.
    workers
        Processes of such a cluster.
    """

    def __init__(self, address: str, workers: int) -> None:
        self.address = address
        self.workers = workers

    def run(self, function: Callable[[T], R], tasks: Sequence[T]) -> Iterator[tuple[int, R | None]]:
        """Yield the number of each task and its result; None where its workers were killed.

        A cluster of one's own tries a task once more after a kill, another as often as it is told.
        """
        from distributed.scheduler import KilledWorker

        with ExitStack() as stack:
            client = self._client(stack)
            numbers = {client.submit(function, t, pure=False): i for i, t in enumerate(tasks)}
            for future in _distributed().as_completed(list(numbers)):
                number = numbers.pop(future)
                error = future.exception() if future.status != "finished" else None
                if error is not None and not isinstance(error, KilledWorker):
                    raise error
                yield number, None if error is not None else future.result()
                future.release()

    def _client(self, stack: ExitStack) -> Any:
        import dask

        distributed = _distributed()
        if self.address:
            with quiet(), reached(f"dask:{self.address}"):
                return stack.enter_context(distributed.Client(self.address, timeout=REACHED_S))
        stack.enter_context(dask.config.set({"distributed.scheduler.allowed-failures": 1}))
        with quiet():
            cluster = distributed.LocalCluster(
                n_workers=self.workers,
                threads_per_worker=1,
                dashboard_address=":0",
                silence_logs=logging.CRITICAL,
            )
        stack.enter_context(cluster)
        return stack.enter_context(distributed.Client(cluster))


def _distributed() -> Any:
    """Return the package, which has no types."""
    import distributed

    return distributed


class RayEngine:
    """Runs tasks on a Ray cluster; what they give comes back over the network.

    Parameters
    ----------
    address
        Of the cluster, as ``ray://HOST:10001`` or ``auto``; one of this computer is started where
        empty.
    workers
        Processors of such a cluster.
    """

    def __init__(self, address: str, workers: int) -> None:
        self.address = address
        self.workers = workers

    def run(self, function: Callable[[T], R], tasks: Sequence[T]) -> Iterator[tuple[int, R | None]]:
        """Yield the number of each task and its result; None where two workers were killed."""
        import ray

        with scratch_folder() as empty:
            # workers look for modules where this process is while it makes contact
            with chdir(empty), quiet():
                self._begin()
            try:
                remote = ray.remote(function).options(max_retries=1)
                numbers = {remote.remote(task): number for number, task in enumerate(tasks)}
                while numbers:
                    (ready,), _ = ray.wait(list(numbers), num_returns=1)
                    number = numbers.pop(ready)
                    try:
                        yield number, ray.get(ready)
                    except (ray.exceptions.WorkerCrashedError, ray.exceptions.OutOfMemoryError):
                        yield number, None
            finally:
                ray.shutdown()

    def _begin(self) -> None:
        import ray

        if self.address:
            with reached(f"ray:{self.address}"):
                _listens(self.address)
                ray.init(address=self.address, log_to_driver=False)
        else:
            ray.init(
                address="local",
                num_cpus=self.workers,
                include_dashboard=False,
                log_to_driver=False,
                logging_level=logging.ERROR,
            )


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
        said = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise RecordingError(f"--engine {address}: expected a cluster, found: {said}") from error


@contextmanager
def quiet() -> Iterator[None]:
    """Let processes start with one thread of their own, deaf to Ctrl-C, which is ours to answer.

    They do not look for modules in the working folder.
    """
    unset = limit_blas_threads()
    ours = threading.current_thread() is threading.main_thread()
    before = signal.signal(signal.SIGINT, signal.SIG_IGN) if ours else None
    try:
        with safe_path():
            yield
    finally:
        if ours:
            signal.signal(signal.SIGINT, before)
        for name in unset:
            del os.environ[name]
