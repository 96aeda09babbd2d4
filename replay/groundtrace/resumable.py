"""A replay that can be broken off: asked to stop, or killed, and going on later from there.

Between windows of the recording nothing is on its way. There a checkpoint is written from time to
time, and when the user asks to stop; what is decided before it is whole in the results.
"""

from __future__ import annotations

import signal
import threading
import time
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from .checkpoint import (
    Checkpoint,
    checkpoint_path,
    read_checkpoint,
    remove_checkpoint,
    write_checkpoint,
)
from .engine import Tally
from .errors import CheckpointError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from groundtrace_codecs.recording import Recording

    from .checkpoint import Origin
    from .pipeline import Pipeline
    from .results import ResultsSink
    from .source import Source

#: Wall time between checkpoints [s], and how many times as long as writing one it is at least.
EVERY_S, PATIENCE = 30.0, 50.0


@dataclass(slots=True)
class Stop:
    """Whether the user has asked to stop.

    Attributes
    ----------
    asked
        True from the first signal on.
    hurry
        Called at the first signal: ends waiting for a paced clock.
    """

    asked: bool = False
    hurry: Callable[[], None] | None = None

    def ask(self) -> None:
        """Stop at the next place where a replay can; a second time, at once.

        Raises
        ------
        KeyboardInterrupt
            The second time.
        """
        if self.asked:
            raise KeyboardInterrupt
        self.asked = True
        if self.hurry is not None:
            self.hurry()


@contextmanager
def stopping(stop: Stop) -> Iterator[None]:
    """Let Ctrl-C and SIGTERM ask to stop; outside the main thread nothing changes."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    handled = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(number, lambda *_: stop.ask()) for number in handled]
    try:
        yield
    finally:
        for number, handler in zip(handled, before, strict=True):
            signal.signal(number, handler)


def _nothing() -> None:
    """Do nothing: what has not begun is settled."""


@dataclass(slots=True)
class Keeper:
    """Keeps a replay so that it can go on.

    Attributes
    ----------
    origin
        What is replayed, and through what.
    recording, source, chain, stored
        Who takes part.
    warn
        Told once, where no checkpoint can be written.
    tally
        What was produced so far.
    stop
        Whether the user has asked to stop.
    watches
        Of placements, by topic.
    sensors
        What was heard of worn sensors, see :func:`groundtrace.health.imu.judged`.
    every_s
        Wall time between checkpoints [s].
    settle
        Brings what the source has given to its end in the results.
    stopped
        True once the replay was ended before its end.
    resumable
        Whether the last checkpoint was written.
    """

    origin: Origin
    recording: Recording
    source: Source
    chain: Pipeline
    stored: ResultsSink
    warn: Callable[[str], None]
    tally: Tally = field(default_factory=Tally)
    stop: Stop = field(default_factory=Stop)
    every_s: float = EVERY_S
    settle: Callable[[], None] = _nothing
    watches: dict[str, Any] = field(default_factory=dict)
    sensors: dict[str, Any] = field(default_factory=dict)
    stopped: bool = False
    resumable: bool = True
    _due_s: float = 0.0

    def begin(self, before: Left | None = None) -> None:
        """Begin anew, or go on from what was left; the results are open and new.

        Raises
        ------
        CodecError
            Where the results that were left do not hold what the checkpoint says.
        """
        self._due_s = time.monotonic() + self.every_s
        if before is not None:
            self._go_on(before.checkpoint, before.results)

    def rest(self) -> bool:
        """Write a checkpoint where one is due; return whether the replay goes on."""
        if self.stop.asked or (self.resumable and time.monotonic() >= self._due_s):
            self.keep()
        self.stopped = self.stop.asked
        return not self.stopped

    def keep(self) -> None:
        """Write a checkpoint of what the replay stands at."""
        self.settle()
        began = time.monotonic()
        try:
            write_checkpoint(checkpoint_path(self.stored.path), self._checkpoint())
            self.resumable = True
        except CheckpointError as error:
            if self.resumable:
                self.warn(f"{error}; this replay cannot be resumed")
            self.resumable = False
        now = time.monotonic()
        self._due_s = now + max(self.every_s, PATIENCE * (now - began))

    def _checkpoint(self) -> Checkpoint:
        return Checkpoint(
            origin=self.origin,
            reached_ns=self.source.reached_ns,
            kept=self.stored.settle(),
            tally=self.tally,
            damage=self.recording.damage,
            source=self.source.save(),
            watches=(self.watches, self.sensors),
            stages=self.chain.save(),
        )

    def _go_on(self, checkpoint: Checkpoint, before: Path) -> None:
        self.stored.take_over(checkpoint.kept, before)
        self.source.restore(checkpoint.source)
        self.source.reached_ns = checkpoint.reached_ns
        self.chain.restore(checkpoint.stages)
        watches, sensors = checkpoint.watches
        self.watches.update(watches)
        self.sensors.update(sensors)
        self.keep()
        if before != self.stored.path:
            before.unlink()

    def end(self) -> None:
        """Say where the results end, or that nothing is left to do."""
        if self.stopped:
            self.stored.stop(self.source.reached_ns)
        else:
            remove_checkpoint(checkpoint_path(self.stored.path))


@dataclass(frozen=True, slots=True)
class Left:
    """A replay that was broken off, as it was left.

    Attributes
    ----------
    checkpoint
        Where it stood.
    results
        Its results: under their name, or still growing where it was killed.
    """

    checkpoint: Checkpoint
    results: Path

    @property
    def ending(self) -> str:
        """What new results end in while they grow, so that these are not written over."""
        return "partial2" if self.results.name.endswith(".partial") else "partial"


def left(results: Path, origin: Origin) -> Left:
    """Return what was left of a replay.

    Raises
    ------
    CheckpointError
        Where it cannot go on.
    """
    checkpoint = read_checkpoint(checkpoint_path(results), origin)
    growing = results.with_name(checkpoint.kept.name)
    before = growing if growing.exists() else results
    if not before.is_file():
        raise CheckpointError(f"{before}: expected the results so far, found no such file")
    return Left(checkpoint, before)
