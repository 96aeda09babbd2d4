"""``groundtrace export``."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from ..api.exporting import export_file
from ..errors import RecordingError
from ..export.base import Origin
from .console import print_json, print_line, print_stderr
from .options import FLAG, OUT, Json


def export_(
    source: Path,
    *,
    out: Annotated[Path, OUT],
    format_: Annotated[str | None, Parameter(name="--format")] = None,
    kind: Annotated[list[str] | None, Parameter(negative="", consume_multiple=True)] = None,
    stage: Annotated[list[str] | None, Parameter(negative="", consume_multiple=True)] = None,
    recording: Path | None = None,
    origin: Annotated[str | None, Parameter(allow_leading_hyphen=True)] = None,
    force: Annotated[bool, FLAG] = False,
    json: Json = False,
) -> None:
    """Write events of a result, or signals of a recording, for other tools.

    Parameters
    ----------
    source
        Results MCAP that groundtrace replay wrote, or a recording.
    out
        The file to write; a name without suffix is a folder that takes a table of each kind.
    format_
        csv, parquet, quakeml, geojson, gpx, audacity, miniseed or that of a plugin; by default as
        the file's name ends.
    kind
        steps, picks, fixes, tracks, bearings, headings, disturbances, disagreements, presence,
        passes, crossings, gaps, notes, truth, annotations, misses, candidates, signals; by default
        all that the format takes, but for signals.
    stage
        Only events of these stages of the pipeline.
    recording
        The recording of results, where it does not lie beside them.
    origin
        Where the site's zero lies: LATITUDE,LONGITUDE [deg], then where its y axis does not point
        north ,AZIMUTH [deg clockwise from north].
    force
        Overwrite what was exported there before.
    """
    report = export_file(
        source,
        out,
        format_,
        kind or (),
        stage or (),
        recording,
        _origin(origin),
        force=force,
        report=print_stderr,
    )
    for reason in report.damage:
        print_stderr(f"warning: {report.source}: damage, not exported: {reason}")
    if json:
        print_json(report)
        return
    words = {"signals": "samples"}
    counts = ", ".join(f"{n} {words.get(name, name)}" for name, n in report.counts.items())
    print_line(f"wrote {report.path}: {report.format}, {counts}")
    for remark in report.remarks:
        print_line(f"  {remark}")


def _origin(text: str | None) -> Origin | None:
    """Read ``LATITUDE,LONGITUDE[,AZIMUTH]``."""
    if text is None:
        return None
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    fits = len(numbers) in (2, 3) and all(map(math.isfinite, numbers))
    if not fits or abs(numbers[0]) > 89.9 or abs(numbers[1]) > 360:
        raise RecordingError(
            f"--origin: expected LATITUDE,LONGITUDE or LATITUDE,LONGITUDE,AZIMUTH [deg], "
            f"found {text!r}"
        )
    return Origin(*map(math.radians, numbers))
