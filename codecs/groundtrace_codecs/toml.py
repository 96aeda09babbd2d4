"""Values as TOML that people read and edit: geometries, maps and pipelines that we write."""

from __future__ import annotations

from typing import Any

import msgspec


def toml_value(value: Any) -> str:
    r"""Return a value on one line of TOML, which reads back as it is.

    What does not show in a text is escaped, as ``\u202e`` is: names come from files of others, and
    with a mark of direction among them a person would read another line than a program.

    Parameters
    ----------
    value
        A number, text or truth value; lists, tuples and tables (string keys) of these.
    """
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(toml_value, value)) + "]"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{toml_value(k)} = {toml_value(v)}" for k, v in value.items()) + "}"
    if isinstance(value, float):
        return repr(value)
    text = msgspec.json.encode(value).decode()  # a basic string of TOML has the escapes of JSON
    return "".join(c if c.isprintable() else _escaped(ord(c)) for c in text)


def _escaped(code: int) -> str:
    return f"\\u{code:04x}" if code < 1 << 16 else f"\\U{code:08x}"
