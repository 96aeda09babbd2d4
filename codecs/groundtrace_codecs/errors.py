"""Errors of the codecs.

::

    CodecError
    ├── FormatError           the bytes are not what the format prescribes
    ├── SchemaError           a message or map does not match its schema
    └── MissingReaderError    the format needs an optional package

Every message reads "FILE: PLACE: expected X, found Y"; the command line prints it as one line.
"""

from __future__ import annotations


class CodecError(Exception):
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


class MissingReaderError(CodecError):
    """A format needs an optional package that is not installed."""

    def __init__(self, what: str, package: str, extra: str) -> None:
        super().__init__(
            f"{what}: expected the package {package}, found none; "
            f"install it with: pip install 'groundtrace[{extra}]'"
        )
