"""Engines: where the work of a fleet is done. Each gives the same answers in another order."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol, TypeVar, cast

from groundtrace_codecs.errors import MissingReaderError

from ..errors import RecordingError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

T = TypeVar("T")
R = TypeVar("R")


class Engine(Protocol):
    """Calls a function for many tasks, in other processes."""

    def run(self, function: Callable[[T], R], tasks: Sequence[T]) -> Iterator[tuple[int, R | None]]:
        """Yield the number of each task and what the function gave, in the order they end.

        None stands for a task whose worker was killed, and that of a second try too. Closing the
        iterator ends what still runs.
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
        from .local import LocalEngine

        return LocalEngine(workers)
    if name == "dask":
        return _made("distributed", "fleet", "on_dask:DaskEngine", address, workers)
    if name == "ray":
        return _made("ray", "ray", "on_ray:RayEngine", address, workers)
    raise RecordingError(
        f"--engine: expected local, dask, dask:ADDRESS, ray or ray:ADDRESS, found {text!r}"
    )


def _made(package: str, extra: str, target: str, address: str, workers: int) -> Engine:
    """Import an engine, which costs seconds, and make one."""
    from importlib import import_module
    from importlib.util import find_spec

    if find_spec(package) is None:
        raise MissingReaderError(f"--engine {package}", package, extra)
    module, _, kind = target.partition(":")
    return cast("Engine", getattr(import_module(f"{__package__}.{module}"), kind)(address, workers))
