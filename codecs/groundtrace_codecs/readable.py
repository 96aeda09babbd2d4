"""Decoding what can be decoded: a message that is not what its schema says costs only itself."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .errors import CodecError

if TYPE_CHECKING:
    from collections.abc import Callable

    from .channels import ChannelReader, Stamped
    from .mcap import Message, MessageTable


def readable(
    reader: ChannelReader,
    messages: MessageTable,
    leave_out: Callable[[Message, CodecError], None],
    *,
    joined: bool = False,
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
    joined
        Whether messages that continue each other become one block.
    """
    try:
        return list(reader.blocks(messages, joined=joined))
    except CodecError as error:
        if len(messages) == 1:
            leave_out(messages[0], error)
            return []
    half = len(messages) // 2
    first = readable(reader, messages[:half], leave_out, joined=joined)
    return first + readable(reader, messages[half:], leave_out, joined=joined)


def pass_over(_message: Message, _error: CodecError) -> None:
    """Say nothing: reading the recording says it."""
