"""What an engine is given to call, and what is said of a task that did not come back.

Light to import: what does the work is imported where there is work to do.
"""

from __future__ import annotations

import platform

from ..results import package_versions
from .places import name_of
from .rows import Row, failed
from .task import Done, Identity, Task, identity_of


def evaluate(task: Task) -> Done:
    """Replay, score and explain; whatever goes wrong becomes the row's error."""
    identity = identity_of(task)
    if identity.key in task.known:
        return Done(identity.key)
    from .evaluate import evaluated

    return evaluated(task, identity, first_row(task, identity))


def lost(task: Task) -> Done:
    """Return what came of a task whose workers were killed, twice."""
    identity = identity_of(task)
    row = first_row(task, identity)
    said = f"{row.recording}: expected a worker that ends, found it killed twice"
    return Done(identity.key, failed(row, said).encoded(), failed=True)


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
