"""Texts of others as they may be shown: on a terminal, or on a page."""

from __future__ import annotations

#: Control characters but tab and newline (C0, DEL, C1; ISO/IEC 6429), and those that say in which
#: direction text runs (Unicode, Annex 9, explicit and implicit directional formatting).
_CONTROLS = (*range(9), *range(11, 32), *range(0x7F, 0xA0))
_DIRECTIONS = (0x61C, 0x200E, 0x200F, *range(0x202A, 0x202F), *range(0x2066, 0x206A))
_ESCAPED = {code: f"\\u{code:04x}" for code in (*_CONTROLS, *_DIRECTIONS)}


def visible(text: str) -> str:
    r"""Return a text whose control characters and marks of direction are escaped, as ``\u001b`` is.

    Names come from files of others: on a terminal they could move the cursor, change what stands
    there, or reverse the order in which it is read, on a page, too. The escapes are those of JSON.
    """
    return text.translate(_ESCAPED)
