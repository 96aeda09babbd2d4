"""Options of ``groundtrace merge`` that name a file or a topic: ``KEY=VALUE``."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from groundtrace_codecs.merging import SHARED_TOPICS

from ..errors import RecordingError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from groundtrace_codecs.recording import Recording

_LARGEST = 1e10


@dataclass(frozen=True, slots=True)
class Keys:
    """What the files may be called in options.

    Attributes
    ----------
    names
        Short name of each file, each another one: the file's stem, with a number where it repeats.
    keys
        Number of the file by its path, file name and short name, where these tell it.
    """

    names: tuple[str, ...]
    keys: Mapping[str, int]

    @classmethod
    def of(cls, sources: Sequence[Path]) -> Keys:
        """Return the names of the files."""
        names: list[str] = []
        for path in sources:
            name, count = path.stem, 2
            while name in names:
                name, count = f"{path.stem}-{count}", count + 1
            names.append(name)
        keys: dict[str, int] = {}
        for kind in ([p.name for p in sources], names, [str(p) for p in sources]):
            keys |= {key: i for i, key in enumerate(kind) if kind.count(key) == 1}
        return cls(tuple(names), keys)

    def number(self, option: str, key: str) -> int:
        """Return which file a key names.

        Raises
        ------
        RecordingError
            Where it names none.
        """
        if key not in self.keys:
            raise RecordingError(
                f"{option}: expected one of {', '.join(self.names)}, found {key!r}"
            )
        return self.keys[key]

    def by_file(self, option: str, values: Sequence[str]) -> dict[int, str]:
        """Return the values of an option FILE=VALUE by the file's number."""
        found = {}
        for text in values:
            key, equals, value = text.partition("=")
            if not (equals and value):
                raise RecordingError(f"{option}: expected FILE=VALUE, found {text!r}")
            found[self.number(option, key)] = value
        return found

    def renames(
        self, rename: Sequence[str], prefix: Sequence[str], recordings: Sequence[Recording]
    ) -> list[dict[str, str]]:
        """Return new names of topics, for each file.

        Raises
        ------
        RecordingError
            Where an option names no file, or no topic of its file.
        """
        topics = [{c.topic for c in r.file.channels.values()} for r in recordings]
        found: list[dict[str, str]] = [{} for _ in recordings]
        for number, start in self.by_file("--prefix", prefix).items():
            start = f"/{start.strip('/')}"
            found[number] = {t: start + t for t in topics[number] - SHARED_TOPICS}
        for text in rename:
            place, equals, new = text.partition("=")
            key, colon, topic = place.rpartition(":")
            if not (equals and colon and new.startswith("/")):
                raise RecordingError(f"--rename: expected FILE:TOPIC=/TOPIC, found {text!r}")
            number = self.number("--rename", key)
            if topic not in topics[number]:
                known = ", ".join(sorted(topics[number] - SHARED_TOPICS))
                raise RecordingError(f"--rename: expected a topic of {known}, found {topic!r}")
            found[number][topic] = new
        return found


def settings(
    option: str, values: Sequence[str] | None, keys: Keys, recordings: Sequence[Recording]
) -> dict[int | str, float]:
    """Return the numbers of an option FILE=NUMBER or TOPIC=NUMBER.

    Raises
    ------
    RecordingError
        Where one names neither file nor topic, or its value is no number.
    """
    topics = {c.topic for r in recordings for c in r.file.channels.values()} - SHARED_TOPICS
    found: dict[int | str, float] = {}
    for text in values or ():
        key, _, number = text.rpartition("=")
        if key not in keys.keys and key not in topics:
            known = ", ".join((*keys.names, *sorted(topics)))
            raise RecordingError(f"{option}: expected one of {known}, found {key!r} in {text!r}")
        try:
            value = float(number)
        except ValueError:
            value = math.nan
        if not abs(value) < _LARGEST:
            raise RecordingError(f"{option}: expected a number, found {number!r} in {text!r}")
        if option == "--drift" and abs(value) > 1e5:
            raise RecordingError(f"--drift: expected at most 1e5 ppm, found {number!r} in {text!r}")
        found[keys.keys.get(key, key)] = value
    return found
