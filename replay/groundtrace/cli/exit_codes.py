"""How commands end: what a shell is told."""

from __future__ import annotations

from enum import IntEnum


class ExitCode(IntEnum):
    """The exit code of a command; docs/command-line.md lists what gives each."""

    #: Everything that was asked for is done.
    DONE = 0
    #: A file, or what is in it, is not what it must be; or there is no room for the output.
    ERROR = 1
    #: Options, names or values that there are not, or that do not go together.
    USAGE = 2
    #: Done, but for what could not be read: damage was left out, or rows of a fleet hold errors.
    LOSSES = 3
    #: The user stopped it (128 and the number of the signal, as shells have it).
    INTERRUPTED = 130

    @classmethod
    def of(cls, *, losses: bool) -> ExitCode:
        """Return how what is done ends, with or without losses."""
        return cls.LOSSES if losses else cls.DONE
