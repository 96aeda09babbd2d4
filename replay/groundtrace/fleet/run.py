"""Running a fleet: tasks to an engine, parts to a folder, and all of them to two tables."""

from __future__ import annotations

from collections import defaultdict
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from ..errors import RecordingError
from .table import Joined, Listed, join
from .task import Task, identity_of, name_part
from .work import evaluate, lost

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from pathlib import Path

    from .engines import Engine
    from .parts import Parts
    from .task import Done, Recipe

#: Recordings whose bytes are read at once to find their parts.
_READERS = 8


@dataclass(slots=True)
class Count:
    """How far a run is.

    Attributes
    ----------
    done, known, failed
        Tasks that went well, were done before, and ended in an error.
    """

    done: int = 0
    known: int = 0
    failed: int = 0

    @property
    def total(self) -> int:
        """Tasks behind us."""
        return self.done + self.known + self.failed


def tasks_of(
    locations: Sequence[str],
    recipes: Sequence[Recipe],
    tolerance_s: float,
    truths: Mapping[str, Path],
) -> list[Task]:
    """Return a task for each recording and pipeline, recording by recording."""
    return [
        Task(
            location,
            recipe,
            tolerance_s,
            str(truths[location]) if location in truths else None,
        )
        for location in locations
        for recipe in recipes
    ]


def shard(tasks: Sequence[Task], index: int, count: int) -> list[Task]:
    """Return the tasks of one shard: those of every ``count``-th recording."""
    order = {place: i for i, place in enumerate(dict.fromkeys(t.location for t in tasks))}
    return [task for task in tasks if order[task.location] % count == index - 1]


def run(
    tasks: Sequence[Task],
    engine: Engine,
    parts: Parts,
    count: Count,
    shown: Callable[[float], None],
    *,
    resume: bool,
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
    resume
        Leave out tasks whose parts are there.
    """
    keys = [""] * len(tasks)
    for index, done in _answers(_knowing(tasks, parts) if resume else tasks, engine):
        keys[index] = done.key
        if done.data is None:
            count.known += 1
        else:
            parts.write(done.key, done.data, failed=done.failed)
            count.failed += done.failed
            count.done += not done.failed
        shown(count.total)
    return [Listed(task.location, key) for task, key in zip(tasks, keys, strict=True)]


def _answers(tasks: Sequence[Task], engine: Engine) -> Iterator[tuple[int, Done]]:
    with closing(engine.run(evaluate, tasks)) as answers:  # type: ignore[type-var]
        for index, done in answers:
            yield index, lost(tasks[index]) if done is None else done


def join_parts(tasks: Sequence[Task], parts: Parts, table: Path) -> Joined:
    """Write the tables of all tasks out of parts that others made.

    Raises
    ------
    RecordingError
        Where some are missing.
    """
    with ThreadPoolExecutor(_READERS) as readers:
        found = list(readers.map(identity_of, tasks))
    listed = [
        Listed(task.location, identity.key) for task, identity in zip(tasks, found, strict=True)
    ]
    missing = [item for item in listed if not parts.has(item.key)]
    if missing:
        raise RecordingError(
            f"{parts.folder}: expected {len(listed)} parts, found {len(listed) - len(missing)}; "
            f"the first that is missing is of {missing[0].location}"
        )
    return join(parts, listed, table)


def _knowing(tasks: Sequence[Task], parts: Parts) -> list[Task]:
    """Return the tasks, each told the keys that may be its own: it finds out which by its bytes."""
    known: dict[str, set[str]] = defaultdict(set)
    for key in parts.done():
        known[key.rpartition("-")[0]].add(key)
    return [replace(t, known=frozenset(known.get(name_part(t.location), ()))) for t in tasks]
