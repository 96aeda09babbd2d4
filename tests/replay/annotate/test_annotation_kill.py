"""A process that annotates is killed at any moment: nothing it was told is safe is lost."""

from __future__ import annotations

import random
import signal
import subprocess
import sys
import time
from typing import TYPE_CHECKING

from annotated_recordings import recording_in

from groundtrace.annotate.store import Annotations, stored
from groundtrace_codecs.annotations import read_sidecar

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

#: Adds, edits and deletes without end, and prints each action once it is acknowledged.
ANNOTATE = """
import sys
from pathlib import Path
from groundtrace.annotate.store import Annotations
from groundtrace_codecs.events import Label
with Annotations.open(Path(sys.argv[1]), "ann") as store:
    start = store.key.start_ns
    for i in range(10**6):
        a = store.add(Label(start + i % 19000 * 10**6, "step", note="x" * (i % 400)))
        print("add", a.id, a.label.time_ns, flush=True)
        if i % 3 == 0:
            a = store.edit(a.id, Label(a.label.time_ns + 1, "false"))
            print("add", a.id, a.label.time_ns, flush=True)
        if i % 4 == 3:
            store.delete(a.id)
            print("delete", a.id, 0, flush=True)
"""


def acknowledged(lines: Iterable[str], known: dict[str, int]) -> dict[str, int]:
    """Add what was acknowledged, id and time, until the process is gone."""
    for line in lines:
        if not line.endswith("\n"):
            break
        action, id_, time_ns = line.split()
        if action == "add":
            known[id_] = int(time_ns)
        else:
            del known[id_]
    return known


def killed(recording: Path, after_s: float, known: dict[str, int]) -> dict[str, int]:
    """Annotate, kill the process some time after its first action; return what it acknowledged."""
    process = subprocess.Popen(
        [sys.executable, "-c", ANNOTATE, str(recording)], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    first = process.stdout.readline()
    time.sleep(after_s)
    process.send_signal(signal.SIGKILL)
    known = acknowledged([first], known)
    known = acknowledged(process.stdout, known)
    process.stdout.close()
    assert process.wait() == -signal.SIGKILL
    return known


def test_kill_9_at_any_moment_loses_no_acknowledged_annotation(tmp_path: Path) -> None:
    recording = recording_in(tmp_path)
    moments = random.Random(7)
    known: dict[str, int] = {}
    for _ in range(6):
        known = killed(recording, moments.uniform(0.0, 0.15), known)
        found = stored(recording).content.annotations
        kept = {a.id: a.label.time_ns for a in found}
        differing = {id_ for id_ in known.keys() | kept.keys() if known.get(id_) != kept.get(id_)}
        # the one action that was done but not told before the kill
        assert len(differing) <= 1
        assert all(id_ not in known or _told_late(known[id_], kept.get(id_)) for id_ in differing)
        with Annotations.open(recording, "ann") as store:
            assert store.items == found
            assert read_sidecar(store.path).annotations == found
        known = kept
    assert len(known) >= 6


def _told_late(before_ns: int, now_ns: int | None) -> bool:
    """Whether an annotation was edited or deleted, as the process does next."""
    return now_ns in (None, before_ns + 1)
