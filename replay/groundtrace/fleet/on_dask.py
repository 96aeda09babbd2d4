"""The engine of a Dask cluster: an existing one, or one started for the run."""

from __future__ import annotations

import logging
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any, TypeVar

import dask
import distributed
from distributed.scheduler import KilledWorker

from .engines import REACHED_S, quiet, reached

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

#: The package has no types.
_dask: Any = distributed

T = TypeVar("T")
R = TypeVar("R")


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
        with ExitStack() as stack:
            client = self._client(stack)
            numbers = {client.submit(function, t, pure=False): i for i, t in enumerate(tasks)}
            for future in _dask.as_completed(list(numbers)):
                number = numbers.pop(future)
                error = future.exception() if future.status != "finished" else None
                if error is not None and not isinstance(error, KilledWorker):
                    raise error
                yield number, None if error is not None else future.result()
                future.release()

    def _client(self, stack: ExitStack) -> Any:
        if self.address:
            with quiet(), reached(f"dask:{self.address}"):
                return stack.enter_context(_dask.Client(self.address, timeout=REACHED_S))
        stack.enter_context(dask.config.set({"distributed.scheduler.allowed-failures": 1}))
        with quiet():
            cluster = _dask.LocalCluster(
                n_workers=self.workers,
                threads_per_worker=1,
                dashboard_address=":0",
                silence_logs=logging.CRITICAL,
            )
        stack.enter_context(cluster)
        return stack.enter_context(_dask.Client(cluster))
