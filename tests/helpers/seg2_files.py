"""SEG-2 files built byte by byte (S. E. Pullan, Geophysics 55, 1990)."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

CODES = {"<i2": 1, "<i4": 2, "<f4": 4, "<f8": 5}


def strings(fields: dict[str, str]) -> bytes:
    """Return the free-form strings of a block, padded to a multiple of four bytes."""
    parts = []
    for key, value in fields.items():
        text = f"{key} {value}".encode() + b"\0"
        parts.append(struct.pack("<H", len(text) + 2) + text)
    joined = b"".join(parts) + b"\0\0"
    return joined + b"\0" * (-len(joined) % 4)


def write_shot(
    path: Path,
    samples: NDArray[np.generic],
    *,
    rate_hz: float = 1000.0,
    source: str | None = "-5.00",
    receivers: Sequence[str] | None = None,
    second: int = 0,
    file_fields: dict[str, str] | None = None,
    trace_fields: dict[str, str] | None = None,
) -> Path:
    """Write one shot; ``samples`` has the shape (n_samples, n_channels)."""
    code = CODES[samples.dtype.str]
    traces = []
    for i, column in enumerate(samples.T):
        fields = {"CHANNEL_NUMBER": str(i + 1), "SAMPLE_INTERVAL": f"{1 / rate_hz:.9f}"}
        if source is not None:
            fields["SOURCE_LOCATION"] = source
        if receivers is not None:
            fields["RECEIVER_LOCATION"] = receivers[i]
        text = strings(fields | (trace_fields or {}))
        data = np.ascontiguousarray(column).tobytes()
        head = struct.pack("<HHIIB", 0x4422, 32 + len(text), len(data), len(column), code)
        traces.append(head.ljust(32, b"\0") + text + data)
    clock = {"ACQUISITION_DATE": "02/Feb/2013", "ACQUISITION_TIME": f"15:08:{second:02d}"}
    text = strings(clock | (file_fields or {"UNITS": "METERS"}))
    start = 32 + 4 * len(traces) + len(text)
    sizes = np.cumsum([0, *(len(t) for t in traces[:-1])])
    head = struct.pack("<HHHHBccBcc", 0x3A55, 1, 4 * len(traces), len(traces), 1, b"\0", b"\0", 1,
                       b"\n", b"\0")  # fmt: skip
    pointers = struct.pack(f"<{len(traces)}I", *(start + int(s) for s in sizes))
    path.write_bytes(head.ljust(32, b"\0") + pointers + text + b"".join(traces))
    return path
