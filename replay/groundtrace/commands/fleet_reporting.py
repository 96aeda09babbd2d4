"""``groundtrace fleet-report``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from ..appearing import write_text
from ..fleet.measures import changes, pairs_of
from ..fleet.reading import missed_steps, read_table
from ..fleet.report import fleet_page
from ..fleet.report_changes import change_cells
from ..pipeline import build_pipeline, load_pipeline, named_pipelines
from .output import print_json, print_table, say, writable

if TYPE_CHECKING:
    from ..fleet.measures import Change
    from ..fleet.reading import FleetTable

FLAG = Parameter(negative="")


@dataclass(frozen=True, slots=True)
class ChangeInfo:
    """A figure before and after."""

    figure: str
    unit: str
    pipeline: str
    recordings: int
    before: float
    after: float
    interval: tuple[float, float] | None
    verdict: str


@dataclass(frozen=True, slots=True)
class FleetReportInfo:
    """What a report says, as JSON."""

    report: str
    table: str
    rows: int
    errors: int
    against: str | None
    paired: int
    changes: list[ChangeInfo]


def fleet_report(
    table: Path,
    *,
    out: Annotated[Path, Parameter(name=["--out", "-o"])],
    against: Path | None = None,
    force: Annotated[bool, FLAG] = False,
    json: Annotated[bool, FLAG] = False,
) -> None:
    """Show a fleet's table as a page that opens in any browser, offline.

    It names recordings as the table does. A pipeline that is none of those that ship is written
    beside it, for the commands on the page.

    Parameters
    ----------
    table
        Parquet that groundtrace fleet wrote; its misses are read from NAME.steps.parquet beside it.
    out
        The page to write, HTML.
    against
        An earlier table: each figure is judged better, worse or undecided on all recordings that
        both have.
    force
        Overwrite an existing page.
    json
        Print one JSON document.
    """
    writable(out, force=force, sources=[table])
    fleet = read_table(table)
    old = None if against is None else read_table(against)
    page = fleet_page(fleet, missed_steps(table), _pipeline_files(fleet, out), old)
    write_text(out, page)
    found = [] if old is None else changes(old, fleet)
    if json:
        errors = sum(bool(error) for error in fleet.of("error"))
        paired = 0 if old is None else len(pairs_of(old, fleet))
        told = [_info(change) for change in found]
        compared = None if against is None else against.name
        print_json(
            FleetReportInfo(str(out), table.name, len(fleet), errors, compared, paired, told)
        )
    elif old is not None:
        header = ("figure", "pipeline", "recordings", "before", "now", "change", "interval", "")
        print_table(header, [(*change_cells(c), c.verdict) for c in found])
    say(f"page: {out}")


def _info(change: Change) -> ChangeInfo:
    interval = change.interval
    return ChangeInfo(
        change.measure.name,
        change.measure.unit,
        change.pipeline,
        change.recordings,
        change.before,
        change.after,
        None if interval is None else (interval.low, interval.high),
        change.verdict,
    )


def _pipeline_files(fleet: FleetTable, out: Path) -> dict[str, str]:
    """Return what each pipeline is called on the command line; write those that do not ship."""
    shipped = named_pipelines()
    files: dict[str, str] = {}
    for name, recipe in zip(fleet.of("pipeline"), fleet.of("parameters"), strict=True):
        if not recipe or name in files:
            continue
        files[name] = name
        if name not in shipped or build_pipeline(load_pipeline(name)).recipe() != recipe:
            path = out.with_name(f"{out.stem}.{name}.toml")
            write_text(path, recipe)
            say(f"pipeline: {path}")
            files[name] = str(path)
    return files
