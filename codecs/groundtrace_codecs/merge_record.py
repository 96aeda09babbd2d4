"""What a merged recording says about the clocks of the files it was merged of."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import msgspec

from .clocks import DeviceClock
from .errors import SchemaError
from .signals import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Sequence

    from .recording import Recording

#: Name of the metadata record that says what was merged, and with which clocks.
MERGE = "groundtrace.merge"


@dataclass(frozen=True, slots=True)
class MergedClock:
    """How the clock of a file, or of some topics of it, was taken to stand to the first file's.

    Attributes
    ----------
    file, sha256
        Name of the file, and of its bytes.
    name
        What the file is called in the merged one: its channels say that they are from it.
    topics
        Topics of the merged file that it is about; empty: all of the file but those named else.
    ahead_ns, drift_ppm, about_ns
        See :class:`.clocks.DeviceClock`.
    how
        ``reference``, ``given``, ``steps``, ``impacts`` or ``as recorded``.
    matched, events
        How many of how many steps or impacts agree; 0 where none were used.
    sigma_s, drift_sigma_ppm
        Deviation of offset [s] and drift; None where unknown.
    note
        What a reader should know besides.
    """

    file: str
    sha256: str
    name: str = ""
    topics: tuple[str, ...] = ()
    ahead_ns: int = 0
    drift_ppm: float = 0.0
    about_ns: int = 0
    how: str = "reference"
    matched: int = 0
    events: int = 0
    sigma_s: float | None = None
    drift_sigma_ppm: float | None = None
    note: str = ""

    @property
    def clock(self) -> DeviceClock:
        """The clock itself."""
        return DeviceClock(self.ahead_ns, self.drift_ppm, self.about_ns)

    def line(self, first: str) -> str:
        """Return in words how the clock stands to that of the first file."""
        what = " ".join((*self.topics, "of", self.file)) if self.topics else self.file
        if self.how in ("reference", "as recorded"):
            return f"clock of {what}: taken as it is"
        ahead_s = self.ahead_ns / NS_PER_S
        error = "" if self.sigma_s is None else f" +- {self.sigma_s * 1e3:.1f} ms"
        text = f"clock of {what}: {abs(ahead_s):.6f} s{error} "
        than = "the common clock" if first == self.file else first
        text += f"{'ahead of' if ahead_s >= 0 else 'behind'} {than} at its start"
        if self.drift_ppm:
            sure = "" if self.drift_sigma_ppm is None else f" +- {self.drift_sigma_ppm:.1f}"
            kind = "fast" if self.drift_ppm > 0 else "slow"
            text += f", {abs(self.drift_ppm):.2f}{sure} ppm {kind}"
        found = f"{self.how}, {self.matched} of {self.events}" if self.events else self.how
        return f"{text} ({found})"


def clocks_record(clocks: Sequence[MergedClock]) -> dict[str, str]:
    """Return the values of the metadata record."""
    return {"json": msgspec.json.encode(list(clocks)).decode()}


def merged_clocks(recording: Recording) -> tuple[MergedClock, ...]:
    """Return with which clocks a recording was merged; empty where it was not.

    Raises
    ------
    SchemaError
        Where its record of them cannot be read.
    """
    text = recording.metadata.get(MERGE, {}).get("json")
    if text is None:
        return ()
    try:
        return msgspec.json.decode(text, type=tuple[MergedClock, ...])
    except msgspec.DecodeError as error:
        raise SchemaError(
            f"{recording.name}: metadata: {MERGE}: expected clocks, found: {error}"
        ) from error
