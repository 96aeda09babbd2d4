"""Errors of the codecs, under the root of everything that groundtrace raises on purpose.

::

    Error                     also that of the engine's and the viewers' errors
    CodecError(Error)
    ├── FormatError           the bytes are not what the format prescribes
    ├── SchemaError           a message or map does not match its schema
    ├── NoRoomError           the disk does not take what is written
    └── MissingReaderError    the format needs an optional package

Every message reads "FILE: PLACE: expected X, found Y"; the command line prints it as one line.
"""

from __future__ import annotations

import errno
import os
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path


class Error(Exception):
    """Root of everything that groundtrace raises on purpose; its text is one line."""


class CodecError(Error):
    """Root of everything the codecs raise on purpose.

    Parameters
    ----------
    message
        What is printed; names that a file gives may hold line breaks, which become spaces.
    """

    def __init__(self, message: str = "") -> None:
        super().__init__(" ".join(message.splitlines()))


class FormatError(CodecError):
    """The bytes are not what the format prescribes."""


class SchemaError(CodecError):
    """A message, map or table does not match its schema."""


class NoRoomError(CodecError):
    """The system does not take what is written.

    Parameters
    ----------
    path
        The output.
    reason
        What the system says.
    remedy
        What stays of it, and what can be done with that.
    """

    def __init__(self, path: Path, reason: str | None, remedy: str = "") -> None:
        super().__init__(f"{path}: {not_written(reason)}{remedy}")
        self.reason = reason


#: What the system says where it does not let a file be written: on Windows also where another
#: program has it open.
_REFUSED = {os.strerror(number) for number in (errno.EACCES, errno.EPERM)}


def not_written(reason: str | None) -> str:
    """Return what was expected of a place to write to, and what the system says instead.

    Parameters
    ----------
    reason
        What it says.
    """
    if reason in _REFUSED:
        refused = f"expected a file that can be written or replaced, found: {reason}"
        return f"{refused} (is it open in another program, or another user's?)"
    return f"expected room to write, found: {reason}"


class MissingReaderError(CodecError):
    """A format needs an optional package that is not installed."""

    def __init__(self, what: str, package: str, extra: str) -> None:
        super().__init__(
            f"{what}: expected the package {package}, found none; "
            f"install it with: pip install 'groundtrace[{extra}]'"
        )


def did_you_mean(value: object, accepted: Iterable[str]) -> str:
    """Return ``; did you mean X?`` with the known spelling nearest to a wrong one, or nothing.

    Parameters
    ----------
    value
        What stands there instead of one of ``accepted``.
    accepted
        The spellings that are accepted.

    Examples
    --------
    >>> did_you_mean("accelration", ["pressure", "acceleration"])
    '; did you mean acceleration?'
    """
    from difflib import get_close_matches

    spellings = {name.casefold(): name for name in accepted}
    near = get_close_matches(str(value).strip().casefold(), spellings, n=1)
    return f"; did you mean {spellings[near[0]]}?" if near else ""
