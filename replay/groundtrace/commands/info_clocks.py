"""Lines of ``groundtrace info`` about clocks: of merged files, of devices that count samples."""

from __future__ import annotations

from typing import TYPE_CHECKING

from groundtrace_codecs.errors import SchemaError
from groundtrace_codecs.importers.mapped import CLOCKS
from groundtrace_codecs.merge_record import merged_clocks

if TYPE_CHECKING:
    from groundtrace_codecs.recording import Recording


def clock_lines(recording: Recording) -> list[str]:
    """Return what a recording keeps of the clocks that its samples were recorded with."""
    try:
        merged = merged_clocks(recording)
    except SchemaError as error:
        return [str(error)]
    lines = [clock.line(merged[0].file) for clock in merged if clock.how != "reference"]
    for name, values in recording.metadata.items():
        if name.partition("/")[0] == CLOCKS:
            lines += [f"{topic}: {text}" for topic, text in values.items()]
    return lines
