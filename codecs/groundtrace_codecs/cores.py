"""Work on several cores at once: what runs without the interpreter's lock, by threads."""

from __future__ import annotations

import os
from collections import deque
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import islice
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

T = TypeVar("T")

#: Tasks that are done ahead: a window may need two chunks.
_AHEAD = 2


def cores() -> int:
    """Return how many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@cache
def _reader() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(1, thread_name_prefix="groundtrace-reader")


if hasattr(os, "register_at_fork"):  # threads do not live on in a forked process
    os.register_at_fork(after_in_child=_reader.cache_clear)


def ahead(tasks: Iterable[Callable[[], T]]) -> Iterator[T]:
    """Yield the results of tasks, in their order, the next ones done while one is used.

    They are done one after the other, in another thread. The first is done in this one, and before
    the second is asked for nothing is done ahead: whoever looks at the first alone waits for no
    other. On one core each is done when it is asked for.
    """
    left = iter(tasks)
    for task in islice(left, 1 if cores() > 1 else None):
        yield task()
    pending = deque(_reader().submit(task) for task in islice(left, _AHEAD))
    try:
        while pending:
            found = pending.popleft().result()
            pending.extend(_reader().submit(task) for task in islice(left, 1))
            yield found
    finally:
        for other in pending:
            other.cancel()
