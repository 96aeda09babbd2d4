"""The one way to the viewer: what it has no glyph for is replaced before it gets there.

Rerun 0.41 ends with an error where it lays out a character that its font lacks: a note in Japanese,
an emoji in a channel's name. It has two fonts, one for texts and one for code in Markdown, and
neither has Hebrew, Arabic, Indian, Thai or East Asian letters, or emoji. All that is logged goes
through :func:`log`, :func:`send_columns` and :func:`send_layout`. Files and pages keep the
original.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterable

    import pyarrow as pa
    import rerun as rr
    import rerun.blueprint as rrb

#: What stands for a character without a glyph.
SUBSTITUTE = "?"
#: Characters of Inter, the font of texts, as code points in base 16. Source: fonts of rerun 0.41.
_TEXT = (
    "20-7E A0-AC AE-148 14A-1C3 1C5-31E 321-377 37A-37F 384-38A 38C 38E-3A1 3A3-3E1 3F0-49D "
    "4A0-4FF 52F E3F 1D43 1D47-1D49 1D4D 1D4F-1D50 1D52 1D56-1D58 1D5B 1D62-1D65 1D9C 1DA0 "
    "1DBB 1DBF-1DF5 1DFC-1F15 1F18-1F1D 1F20-1F45 1F48-1F4D 1F50-1F57 1F59 1F5B 1F5D "
    "1F5F-1F7D 1F80-1FB4 1FB6-1FC4 1FC6-1FD3 1FD6-1FDB 1FDD-1FEF 1FF2-1FF4 1FF6-1FFE "
    "2000-200A 2010-2027 202F-205F 2070-2071 2074-208E 2090-209C 20A0-20BF 20DB-20DE 20E8 "
    "20F0 2100-2101 2103 2105-2106 2109 2113 2116-2117 211E-2123 2126 212A-212B 212E 2132 "
    "213B 214D 214F 2153 215A-2188 2190-2199 21A9-21AA 21B0-21B1 21B3-21B5 21BA-21BB 21D0 "
    "21D2 21D4 21DE-21DF 21E4-21E5 21E7 21EA 2202 2205-2206 220F 2211-2212 221A 221E 222B "
    "2248 2260 2264-2265 2303 2305 2318 2325-2327 232B 2380 2387 238B 23CE-23CF 2423 "
    "2460-2468 24B6-24CF 24EA 25A0-25A2 25AA 25B2-25B3 25B6-25B7 25BA-25BD 25C0-25C1 "
    "25C4-25C7 25CA-25CB 25CF 25E6 25EF 2600 2605-2606 263C 2661 2665 26A0 2713 2717 2756 "
    "2764 2780-2788 27EF 27F5-27FA 2B06 2B12-2B13 2B1C 2C7C 2C7F 2DFF 2E18 A69F A7FF A92E "
    "FE20-FE2D 1F12F-1F149 1F16A-1F16B 1F850 1F852 "
)
#: Characters of JetBrains Mono, the font of code in Markdown, which has no other to fall back on.
_CODE = (
    "20-7E A0-AC AE-17F 18F-190 192 19B 1A0-1A1 1AF-1B0 1CD-1DC 1E6-1E7 1EA-1EB 1F4-1F5 "
    "1FC-1FF 218-21B 232-233 237 259 25B 2B9-2BA 2BC 2C6-2C7 2C9 2D8-2DD 2F3 2F7 300-304 "
    "306-30C 30F 312 31B 323 325-328 336-338 374-375 37E 384-38A 38C 38E-3A1 3A3-3CF 3D5-3D7 "
    "401-40C 40E-44F 451-45C 45E-45F 490-493 49A-49B 4A2-4A3 4AE-4B1 4B6-4B7 4BA-4BB 4D8-4D9 "
    "4DC-4DF 4E4-4E9 4F4-4F5 AEA 1E80-1E85 1E9E 1EA0-1EF9 2001 2010 2013-2014 2016 2018-2022 "
    "2024 2026 2030 2032-2034 2039-203A 203C-203F 2044-2046 2070 2074-207A 207C 2080-2089 "
    "20AB-20AC 20AE 20B4 20BD 20BF 2102 210D 2113 2115-2116 2119-211A 211D 2122 2124 212E "
    "2140 218A-218B 2190-2199 219D-219E 21A0 21A2-21A3 21A5-21A7 21A9-21AA 21AD 21BE 21C9 "
    "21D0-21D4 21DB 21DE-21DF 21E5 21E7-21E8 21EA 2200-220C 220E-2213 2215 2218-221A 221E "
    "2223-2225 2227-222B 2234-2239 223C 223E 2243 2245 2247-2249 224B 224D 2254 2257 "
    "225F-2265 226A-2273 227A-227C 2282-2289 228E-2299 229B-22A5 22B4 22B8 22BB-22BD "
    "22C2-22C4 22C6 22C8-22CA 22CE 22D0 22E2 22EE-22F1 2302-2305 2308-230B 2318 231C-231F "
    "2324-2326 2328 232B 2336-237A 2389-238B 2395 239B-23AD 23CE 23FB-23FE 2400-2421 "
    "2423-2424 2500-25A1 25AA-25AB 25B2-25CC 25CE-25CF 25D4-25D5 25E6-25EB 25EF 25F6 266D "
    "266F 2687 26A0-26A1 2713 2715 2717 2736 276E-2771 2794 279C-279E 27C5-27C6 27DC "
    "27E6-27EB 27F5-27F7 2916 294A 2987-2988 2A00 2A05-2A06 2B58 FE62 FF5B FF5D FFFD 16910 "
    "1D538-1D539 1D53B-1D53E 1D540-1D544 1D546 1D54A-1D550 1D552-1D56B "
)
#: Line ends and tabs are laid out, not drawn.
_LAYOUT = "\n\t"
#: Code in Markdown: between backticks, and lines that are indented.
_CODE_PARTS = re.compile(r"(`+)(?!`).*?\1|^(?: {4}|\t).*$", re.DOTALL | re.MULTILINE)
#: Components of a layout whose texts name entities.
_NAMES_OF_ENTITIES = ("ViewBlueprint:space_origin", "ViewContents:query")


@cache
def _without(ranges: str) -> re.Pattern[str]:
    """Return what finds a character that is in none of the ranges."""
    ends = (item.partition("-") for item in ranges.split())
    allowed = "".join(f"\\U{int(a, 16):08X}-\\U{int(b or a, 16):08X}" for a, _, b in ends)
    return re.compile(f"[^{_LAYOUT}{allowed}]")


def legible(text: str) -> str:
    """Return a text with :data:`SUBSTITUTE` for each character that the viewer cannot draw."""
    if text.isascii() and text.isprintable():
        return text
    shown = _without(_TEXT).sub(SUBSTITUTE, text.replace("\r\n", "\n"))
    code = _without(_CODE)
    return _CODE_PARTS.sub(lambda part: code.sub(SUBSTITUTE, part[0]), shown)


def legible_path(path: str) -> str:
    """Return an entity path that the viewer can draw; different paths stay different."""
    if path.isascii():
        return path
    return _without(_TEXT).sub(lambda match: f"u{ord(match[0]):x}", path)


def log(
    recording: rr.RecordingStream, path: str, *archetypes: rr.AsComponents, static: bool = False
) -> None:
    """Log archetypes, as the viewer can draw them."""
    batches = [batch for each in archetypes for batch in each.as_component_batches()]
    recording.log(legible_path(path), [_legible_batch(batch) for batch in batches], static=static)


def send_columns(
    recording: rr.RecordingStream,
    path: str,
    indexes: Iterable[rr.TimeColumn],
    columns: Iterable[rr.ComponentColumn],
) -> None:
    """Send columns, as the viewer can draw them."""
    shown = [_legible_column(column) for column in columns]
    recording.send_columns(legible_path(path), indexes=indexes, columns=shown)


def send_layout(recording: rr.RecordingStream, layout: rrb.Blueprint) -> None:
    """Send a layout, as the viewer can draw its titles."""
    shown: Any = _LegibleLayout(layout)
    recording.send_blueprint(shown)


@dataclass(frozen=True, slots=True)
class _Arrow:
    """Values as the library takes those of a batch or column."""

    array: pa.Array
    kind: Any = None

    def as_arrow_array(self) -> pa.Array:
        return self.array

    def component_descriptor(self) -> Any:
        return self.kind


def _legible_batch(batch: rr.DescribedComponentBatch) -> rr.DescribedComponentBatch:
    import rerun as rr

    array, kind = batch.as_arrow_array(), batch.component_descriptor()
    shown = _legible_array(array, paths=kind.component in _NAMES_OF_ENTITIES)
    return batch if shown is array else rr.DescribedComponentBatch(_Arrow(shown), kind)


def _legible_column(column: rr.ComponentColumn) -> Any:
    array = column.as_arrow_array()
    shown = _legible_array(array, paths=False)
    return column if shown is array else _Arrow(shown, column.component_descriptor())


def _legible_array(array: pa.Array, *, paths: bool) -> pa.Array:
    """Return values with legible texts, however deep; the same object where all are."""
    import pyarrow as pa

    kind = array.type
    if pa.types.is_string(kind) or pa.types.is_large_string(kind):
        before = array.to_pylist()
        replaced = legible_path if paths else legible
        after = [None if text is None else replaced(text) for text in before]
        return array if after == before else pa.array(after, kind)
    if pa.types.is_list(kind):
        values = _legible_array(array.values, paths=paths)
        if values is array.values or values.equals(array.values):
            return array
        mask = array.is_null() if array.null_count else None
        return pa.ListArray.from_arrays(array.offsets, values, type=kind, mask=mask)
    if pa.types.is_struct(kind):
        fields = [array.field(i) for i in range(kind.num_fields)]
        shown = [_legible_array(each, paths=paths) for each in fields]
        if all(a is b for a, b in zip(fields, shown, strict=True)):
            return array
        mask = array.is_null() if array.null_count else None
        return pa.StructArray.from_arrays(shown, fields=list(kind), mask=mask)
    return array


class _LegibleLayout:
    """A layout that logs itself through :func:`log`, as the library asks it to."""

    def __init__(self, layout: rrb.Blueprint) -> None:
        self._layout = layout

    def __getattr__(self, name: str) -> Any:
        return getattr(self._layout, name)

    def to_blueprint(self) -> _LegibleLayout:
        return self

    def _log_to_stream(self, stream: rr.RecordingStream) -> None:
        log_: Any = _LegibleLog(stream)
        self._layout._log_to_stream(log_)


class _LegibleLog:
    """What a layout needs of a recording."""

    def __init__(self, recording: rr.RecordingStream) -> None:
        self._recording = recording

    def __getattr__(self, name: str) -> Any:
        return getattr(self._recording, name)

    def log(self, path: str, entity: Any, *more: Any, **options: Any) -> None:
        batches = []
        for each in (entity, *more):
            components = (
                each.as_component_batches() if hasattr(each, "as_component_batches") else each
            )
            batches += [_legible_batch(batch) for batch in components]
        self._recording.log(legible_path(path), batches, **options)
