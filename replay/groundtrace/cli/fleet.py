"""``groundtrace fleet`` and ``groundtrace fleet-report``."""

from __future__ import annotations

import math
import os
import shlex
import shutil
import sys
import time
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from ..api.files import existing_file, writable
from ..errors import RecordingError, UsageError
from ..fleet.engines import engine_of
from ..fleet.report import MEASURES, change_cells, changes, fleet_page, groups_of, pairs_of
from ..fleet.run import (
    Count,
    join_parts,
    recipes_of,
    recordings_of,
    run,
    shard_of,
    tasks_of,
    truth_beside,
)
from ..fleet.run import shard as shard_tasks
from ..fleet.split import LongOnes
from ..fleet.table import Joined, Parts, join, missed_steps, read_table, steps_path
from ..pipeline.chain import build_pipeline
from ..pipeline.config import load_pipeline, named_pipelines
from ..pipeline.results import public_arguments, write_text
from .console import print_json, print_line, print_stderr, print_table, progress
from .exit_codes import ExitCode
from .options import AT_LEAST_ONE, FLAG, OUT, PIPELINE, POSITIVE, Json, Settings, Texts, Tolerance

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from ..fleet.report import Change
    from ..fleet.run import Task
    from ..fleet.table import FleetTable


@dataclass(frozen=True, slots=True)
class FleetReport:
    """What a run left, as JSON."""

    table: str | None
    steps_table: str | None
    parts: str
    recordings: int
    rows: int
    steps: int
    errors: int
    warnings: int
    done: int
    known: int
    failed: int
    missing: int
    left_out: list[str]
    digest: str | None
    wall_s: float


def fleet(
    *recordings: str,
    out: Annotated[Path, OUT],
    pipeline: Annotated[list[str] | None, FLAG, PIPELINE] = None,
    set_: Settings = None,
    truth: Path | None = None,
    tolerance: Tolerance = 0.12,
    engine: str = "local",
    workers: Annotated[int | None, AT_LEAST_ONE] = None,
    shard: str = "",
    join_: Annotated[bool, Parameter(name="--join", negative="")] = False,
    resume: Annotated[bool, FLAG] = False,
    partial: Annotated[bool, FLAG] = False,
    limit_s: Annotated[float | None, POSITIVE] = None,
    allow_failures: Annotated[bool, FLAG] = False,
    force: Annotated[bool, FLAG] = False,
    json: Json = False,
) -> ExitCode:
    """Take many recordings through some pipelines, into one table.

    OUT holds a row for each recording and pipeline, and beside it NAME.steps.parquet one for each
    step. A recording that cannot be replayed is a row with its error. Where there are more workers
    than recordings, long ones are replayed in spans, as with replay --engine. What is done is kept
    in NAME.parts at once, so that a run can be ended at any time and gone on with. The exit code is
    0 if no recording failed, 3 if some did, 1 if all did.

    Parameters
    ----------
    recordings
        Recordings, folders of them, patterns, and URLs of those (s3://, gs://, https://).
    out
        The table to write, Parquet.
    pipeline
        Name or TOML file; may be given several times. Without it each recording goes through what
        fits it, as with replay.
    set_
        A parameter of a stage of every pipeline, as stage.param=value; may be given several times.
    truth
        Truth instead of that of the one recording; or a folder with NAME.csv for NAME.mcap.
    engine
        Where to compute: local, dask, dask:ADDRESS, ray, ray:ADDRESS.
    workers
        Processes; one for each processor without it. A cluster has its own.
    shard
        Do only the part I/N of the recordings, from 1/N to N/N; then join them with --join.
    join_
        Compute nothing: write the table of the parts that shards made.
    resume
        Skip finished recordings: same recording, truth, pipeline, versions and code.
    partial
        With --join: leave out parts that are missing or broken, and say how many they are; the exit
        code is 3 then.
    limit_s
        The most that a recording may take, in seconds; then it is a row with that error. By default
        50 times its length, and at least 600 s.
    allow_failures
        Exit with 0 whatever failed or is missing.
    force
        Overwrite an existing table.
    """
    began = time.perf_counter()
    part = shard_of(shard) if shard else None
    if part is not None and join_:
        raise UsageError("--shard: expected it without --join, found both")
    recipes = recipes_of(pipeline or [], set_ or [], tolerance)
    if partial and not join_:
        raise UsageError("--partial: expected it with --join, found it alone")
    locations = recordings_of(recordings)
    _check_target(out, force=force or resume or join_ or part is not None)
    tasks = tasks_of(locations, recipes, tolerance, truth_beside(truth, locations), limit_s)
    _check_room(out, len(tasks))
    parts, count = Parts(out.with_suffix(".parts")), Count()
    joined: Joined | None = None
    missing = 0
    command = shlex.join(["groundtrace", *public_arguments(sys.argv[1:])])
    if join_:
        joined, missing = join_parts(tasks, parts, out, command, partial=partial)
    else:
        mine = tasks if part is None else shard_tasks(tasks, *part)
        many = workers or os.cpu_count() or 1
        runs = engine_of(engine, many)
        here = LongOnes(runs, many, print_stderr) if len(mine) < many else (lambda _: None)
        with _resumable(mine, count, parts), progress(len(mine), "fleet", "replays") as show:
            listed = run(mine, runs, parts, count, show, print_stderr, resume=resume, here=here)
        joined = join(parts, listed, out, command) if part is None else None
    report = _report(
        out, parts, len(locations), count, joined, missing, time.perf_counter() - began
    )
    if json:
        print_json(report)
    else:
        _print(report)
        if missing:
            print_line(f"missing or broken: {missing} parts of {len(tasks)}, left out")
    rows, errors = (
        (joined.rows, joined.errors) if joined is not None else (count.total, count.failed)
    )
    if (errors or missing) and not allow_failures:
        return ExitCode.LOSSES if errors < rows else ExitCode.ERROR
    return ExitCode.DONE


#: What a part takes on a disk, more or less [bytes]. Bench: fleets of real walks, 9 kB a part.
_PART_BYTES = 20_000


def _check_room(out: Path, parts: int) -> None:
    """Refuse to begin what the disk of the table has no room for."""
    needed, free = parts * _PART_BYTES, shutil.disk_usage(out.resolve().parent).free
    if needed > free:
        raise RecordingError(
            f"{out}: expected room for {parts} parts, about {needed / 1e6:.2f} MB, "
            f"found {free / 1e6:.2f} MB"
        )


def _check_target(out: Path, *, force: bool) -> None:
    """Refuse a table that is not Parquet, or to overwrite one unasked."""
    if out.suffix.lower() not in (".parquet", ".pq"):
        raise UsageError(f"{out}: expected a name that ends in .parquet, found {out.name}")
    for path in (out, steps_path(out)):
        writable(path, force=force)


@contextmanager
def _resumable(tasks: Sequence[Task], count: Count, parts: Parts) -> Iterator[None]:
    """Say how to go on where a run is interrupted."""
    try:
        yield
    except KeyboardInterrupt:
        again = [a for a in sys.argv[1:] if a != "--resume"]
        print_stderr(
            f"\ninterrupted: {count.total} of {len(tasks)} are done and kept in {parts.folder}; "
            f"go on with: {shlex.join(['groundtrace', *again, '--resume'])}"
        )
        raise


def _report(
    out: Path,
    parts: Parts,
    recordings: int,
    count: Count,
    joined: Joined | None,
    missing: int,
    wall_s: float,
) -> FleetReport:
    return FleetReport(
        str(out) if joined is not None else None,
        str(steps_path(out)) if joined is not None else None,
        str(parts.folder),
        recordings,
        joined.rows if joined is not None else 0,
        joined.steps if joined is not None else 0,
        joined.errors if joined is not None else 0,
        joined.warnings if joined is not None else 0,
        count.done,
        count.known,
        count.failed,
        missing,
        count.left_out,
        joined.digest if joined is not None else None,
        wall_s,
    )


def _print(report: FleetReport) -> None:
    earlier = f", {report.known} were done before" if report.known else ""
    print_line(f"{report.done} replayed, {report.failed} failed{earlier}; {report.wall_s:.1f} s")
    if report.left_out:
        print_line(f"workers left out: {len(report.left_out)}; {report.left_out[0]}")
    if report.table is None:
        print_line(f"parts: {report.parts} (when all shards are there, join them with --join)")
        return
    print_line(f"table: {report.table}, {report.rows} rows of {report.recordings} recordings")
    print_line(f"steps: {report.steps_table}, {report.steps} rows")
    if report.errors:
        print_line(f"errors: {report.errors} rows have one, in the column error")
    if report.warnings:
        print_line(f"warnings: {report.warnings} rows have some, in the column warnings")
    print_line(f"decided: {report.digest} (the same wherever it is computed)")
    print_line(f"look at it with: groundtrace fleet-report {report.table} -o fleet.html")


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
    groups: int
    adjusted_p: float | None


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
    out: Annotated[Path, OUT],
    against: Path | None = None,
    group_by: str = "",
    tags: Path | None = None,
    matters: Texts = None,
    force: Annotated[bool, FLAG] = False,
    json: Json = False,
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
    group_by
        Draw whole groups for intervals: a column of TAGS or of the table, or folder.
    tags
        CSV with the columns recording (file name) or location, and one for each tag.
    matters
        The least difference of a figure that matters, as f1=0.005; may be given several times.
    force
        Overwrite an existing page.
    """
    writable(out, force=force, sources=[table])
    fleet = read_table(table)
    old = None if against is None else read_table(against)
    if tags is not None and not group_by:
        raise UsageError("--tags: expected --group-by COLUMN with it, found none")
    listed = None if tags is None else existing_file(tags, "a table of tags")
    groups = groups_of(fleet, group_by, listed) if group_by else None
    least = _least(matters or [])
    figure_changes = [] if old is None else changes(old, fleet, groups, least)
    files = _pipeline_files(fleet, out)
    write_text(out, fleet_page(fleet, missed_steps(table), files, old, figure_changes, group_by))
    if json:
        errors = sum(bool(error) for error in fleet.of("error"))
        paired = 0 if old is None else len(pairs_of(old, fleet))
        change_infos = [_info(change) for change in figure_changes]
        compared = None if against is None else against.name
        print_json(
            FleetReportInfo(
                str(out), table.name, len(fleet), errors, compared, paired, change_infos
            )
        )
    elif old is not None:
        header = (
            "figure",
            "pipeline",
            "recordings",
            "groups",
            "before",
            "now",
            "change",
            "interval",
            "p, corrected",
            "",
        )
        print_table(header, [(*change_cells(c), c.verdict) for c in figure_changes])
    print_stderr(f"page: {out}")


def _least(texts: Sequence[str]) -> dict[str, float]:
    """Return the least differences that matter, by the key of the figure."""
    keys = [measure.key for measure in MEASURES]
    least = {}
    for text in texts:
        key, _, value = text.partition("=")
        try:
            number = float(value)
        except ValueError:
            number = math.nan
        if key not in keys or not 0 <= number < math.inf:
            expected = f"FIGURE=NUMBER with one of {', '.join(keys)}"
            raise UsageError(f"--matters: expected {expected}, found {text}")
        least[key] = number
    return least


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
        change.groups,
        change.adjusted_p,
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
            print_stderr(f"pipeline: {path}")
            files[name] = str(path)
    return files
