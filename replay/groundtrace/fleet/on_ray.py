"""The engine of a Ray cluster: an existing one, or one started for the run."""

from __future__ import annotations

import socket
from typing import TYPE_CHECKING, TypeVar

import ray

from .engines import REACHED_S, reached

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

T = TypeVar("T")
R = TypeVar("R")


def _listens(address: str) -> None:
    """Raise where nobody listens at an address: the package tries for minutes."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if port.isdecimal():
        socket.create_connection((host, int(port)), REACHED_S).close()


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
                logging_level="ERROR",
            )
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
