"""Decoding what can be decoded: a message that is not what its schema says costs only itself."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .errors import CodecError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from .channels import ChannelReader, Stamped
    from .mcap import Message


def readable(
    reader: ChannelReader,
    messages: Sequence[Message],
    leave_out: Callable[[Message, CodecError], None],
) -> list[Stamped]:
    """Decode messages without those that are not what their schema says.

    Parameters
    ----------
    reader
        Of their channel.
    messages
        In order; where some cannot be decoded, halves of them are tried.
    leave_out
        Is told each message that is left out, and why; it may raise instead.
    """
    try:
        return list(reader.blocks(messages))
    except CodecError as error:
        if len(messages) == 1:
            leave_out(messages[0], error)
            return []
    half = len(messages) // 2
    first = readable(reader, messages[:half], leave_out)
    return first + readable(reader, messages[half:], leave_out)


def pass_over(_message: Message, _error: CodecError) -> None:
    """Say nothing: reading the recording says it."""
