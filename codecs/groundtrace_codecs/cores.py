"""Work on several cores at once: what runs without the interpreter's lock, by threads."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from concurrent.futures import Future

T = TypeVar("T")


def cores() -> int:
    """Return how many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="groundtrace")


@cache
def _reader() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(1, thread_name_prefix="groundtrace-reader")


def _forget() -> None:
    _pool.cache_clear()
    _reader.cache_clear()


if hasattr(os, "register_at_fork"):  # threads do not live on in a forked process
    os.register_at_fork(after_in_child=_forget)


def side_by_side(tasks: Sequence[Callable[[], T]]) -> list[T]:
    """Run tasks, the first in this thread; return their results in their order.

    They must not depend on each other, nor start others in this way. On one core they run one
    after the other.
    """
    if len(tasks) < 2 or cores() < 2:
        return [task() for task in tasks]
    pool = _pool(cores() - 1)
    others = [pool.submit(task) for task in tasks[1:]]
    return [tasks[0](), *(other.result() for other in others)]


def meanwhile(task: Callable[[], T]) -> Future[T]:
    """Begin a task that reads, while this thread goes on; such tasks run one after the other."""
    return _reader().submit(task)
