"""Parser of ``ros2msg`` schemas: a message definition followed by those it depends on.

The text is that of the MCAP specification's well-known schema encoding: definitions separated by
a line of ``=``, each but the first opened by ``MSG: package/Type``.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from functools import lru_cache

from ..errors import SchemaError

#: Wire types of the primitive fields (little-endian numpy codes without byte order).
PRIMITIVES = {
    "bool": "u1",
    "byte": "u1",
    "char": "u1",
    "uint8": "u1",
    "int8": "i1",
    "uint16": "u2",
    "int16": "i2",
    "uint32": "u4",
    "int32": "i4",
    "uint64": "u8",
    "int64": "i8",
    "float32": "f4",
    "float64": "f8",
}
#: Definitions some writers leave out because every ROS 2 tool knows them.
_IMPLIED = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "builtin_interfaces/Duration": "int32 sec\nuint32 nanosec",
}
#: An empty message occupies one byte on the wire.
_EMPTY = "uint8 structure_needs_at_least_one_member"
_MAX_FIELDS = 10_000
_MAX_DEPTH = 32

_SEPARATOR = re.compile(r"^={8,}\s*$", re.MULTILINE)
_COMMENT = re.compile(r"""^((?:[^#"']|"[^"]*"|'[^']*')*)#.*$""")
_LINE = re.compile(
    r"""^(?P<type>[A-Za-z][\w/]*)(?:<=(?P<longest>\d{1,10}))?
        (?P<array>\[(?P<bounded><=)?(?P<count>\d{0,10})\])?
        \s+(?P<name>[A-Za-z]\w*)\s*(?P<rest>.*)$""",
    re.VERBOSE,
)


@dataclass(frozen=True, slots=True)
class Field:
    """One field of a message.

    Attributes
    ----------
    name
        As in the definition.
    primitive
        numpy code, ``str`` for a string, empty for a nested message.
    message
        The nested message's definition, or None.
    count
        Length of a fixed array; None for a single value or a sequence.
    sequence
        True for an unbounded or bounded sequence.
    longest
        Bound of a bounded sequence, or None.
    default
        Default value's text, empty where there is none.
    """

    name: str
    primitive: str
    message: Definition | None
    count: int | None = None
    sequence: bool = False
    longest: int | None = None
    default: str = ""

    @property
    def min_size(self) -> int:
        """Fewest bytes one element takes on the wire, without padding."""
        if self.message is not None:
            return self.message.min_size
        return 4 if self.primitive == "str" else int(self.primitive[1])


@dataclass(frozen=True, slots=True)
class Definition:
    """A message: its name (``package/Type``), fields in wire order, and constants."""

    name: str
    fields: tuple[Field, ...]
    constants: tuple[tuple[str, str], ...] = ()
    min_size: int = field(default=0, compare=False)
    paths: int = field(default=0, compare=False)

    def find(self, name: str) -> Field | None:
        """Return the field of that name, or None."""
        return next((f for f in self.fields if f.name == name), None)


@lru_cache(maxsize=256)
def parse_ros2msg(name: str, text: str) -> Definition:
    """Parse a ``ros2msg`` schema.

    Parameters
    ----------
    name
        Of the schema, ``package/msg/Type`` or ``package/Type``.
    text
        Its content.

    Raises
    ------
    SchemaError
        Where a line is no field, a type is unknown or contains itself; names the message.
    """
    root = _plain(name)
    head, *others = _SEPARATOR.split(text)
    sources = {**_IMPLIED, root: head}
    for other in others:
        title, _, body = other.strip().partition("\n")
        if not title.startswith("MSG:"):
            raise SchemaError(f"{root}: expected 'MSG: package/Type', found {title[:60]!r}")
        sources[_plain(title.removeprefix("MSG:").strip())] = body
    return _Resolver(sources).resolve(root, ())


def _plain(name: str) -> str:
    return name.replace("/msg/", "/")


class _Resolver:
    """Turns the texts of a schema into definitions, each once."""

    def __init__(self, sources: dict[str, str]) -> None:
        self._sources = sources
        self._known: dict[str, Definition] = {}

    def resolve(self, name: str, parents: tuple[str, ...]) -> Definition:
        if name in self._known:
            return self._known[name]
        if name in parents or len(parents) >= _MAX_DEPTH:
            raise SchemaError(f"{name}: expected a finite message, found it nested in itself")
        if name not in self._sources:
            user = parents[-1] if parents else "schema"
            raise SchemaError(f"{user}: expected a definition of {name}, found none")
        constants: list[tuple[str, str]] = []
        fields: list[Field] = []
        for line in self._sources[name].splitlines():
            self._line(name, line, (*parents, name), fields, constants)
        if not fields:
            self._line(name, _EMPTY, parents, fields, constants)
        self._known[name] = _definition(name, fields, constants)
        return self._known[name]

    def _line(
        self,
        owner: str,
        line: str,
        parents: tuple[str, ...],
        fields: list[Field],
        constants: list[tuple[str, str]],
    ) -> None:
        comment = _COMMENT.match(line)
        line = (comment[1] if comment else line).strip()
        if not line:
            return
        match = _LINE.match(line)
        if match is None:
            raise SchemaError(f"{owner}: expected 'type name', found {line[:60]!r}")
        if match["rest"].startswith("="):
            constants.append((match["name"], match["rest"][1:].strip()))
            return
        fields.append(self._field(owner, match, parents))

    def _field(self, owner: str, match: re.Match[str], parents: tuple[str, ...]) -> Field:
        kind = match["type"]
        message = None
        if kind == "string":
            primitive = "str"
        elif kind in PRIMITIVES:
            primitive = PRIMITIVES[kind]
        elif kind == "wstring":
            raise SchemaError(f"{owner}: {match['name']}: expected a string, found a wstring")
        else:
            primitive, message = "", self.resolve(self._qualified(kind, owner), parents)
        number = int(match["count"]) if match["count"] else None
        sequence = match["array"] is not None and (number is None or bool(match["bounded"]))
        return Field(
            match["name"],
            primitive,
            message,
            None if sequence else number,
            sequence,
            number if sequence else None,
            match["rest"],
        )

    @staticmethod
    def _qualified(kind: str, owner: str) -> str:
        if kind == "Header":
            return "std_msgs/Header"
        if "/" in kind:
            return _plain(kind)
        return f"{owner.rpartition('/')[0]}/{kind}"


def _definition(name: str, fields: list[Field], constants: list[tuple[str, str]]) -> Definition:
    size = sum(
        0 if f.sequence else f.min_size * (1 if f.count is None else f.count) for f in fields
    )
    size += sum(4 for f in fields if f.sequence)
    paths = sum(1 if f.message is None else f.message.paths for f in fields)
    if paths > _MAX_FIELDS:
        raise SchemaError(f"{name}: expected at most {_MAX_FIELDS} fields, found {paths}")
    return Definition(name, tuple(fields), tuple(constants), size, paths)
