"""Work on a second core: what runs without the interpreter's lock, by a thread."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from multiprocessing import parent_process
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable
    from concurrent.futures import Future

T = TypeVar("T")


def cores() -> int:
    """Return how many cores this process may use: one, where another started it to share work."""
    if parent_process() is not None:
        return 1
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def started(task: Callable[[], T]) -> Future[T]:
    """Have a task done by the other thread, after those that it was given before."""
    return _other().submit(task)


@cache
def _other() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(1, thread_name_prefix="groundtrace-other")


if hasattr(os, "register_at_fork"):  # threads do not live on in a forked process
    os.register_at_fork(after_in_child=_other.cache_clear)
