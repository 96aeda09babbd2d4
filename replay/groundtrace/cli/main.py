"""The command line. Commands are imported when called, so that ``--help`` needs nothing heavy."""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from io import TextIOWrapper
from typing import TYPE_CHECKING, Any

from cyclopts import App, CycloptsError

from ..runtime import (
    end_as_interrupted,
    leave_working_folder,
    limit_blas_threads,
    raise_malloc_trim,
)
from .exit_codes import ExitCode

if TYPE_CHECKING:
    from collections.abc import Sequence

HERE = "groundtrace.cli"
#: Name, function and help of each command; here, so that listing them imports none.
COMMANDS = {
    "demo": (
        f"{HERE}.demo:demo",
        "Replay the bundled walk of a real person, score it, and name the first missed step.\n\n"
        "Copies lower-back.mcap into the present folder, and leaves beside it the results and the "
        "timeline, which opens where there is a display.\n\n"
        "Example: groundtrace demo",
    ),
    "recordings": (
        f"{HERE}.bundled:recordings",
        "List recordings known by name, show where one is from, or fetch one by its hash.\n\n"
        "Example: groundtrace recordings show lower-back",
    ),
    "import": (
        f"{HERE}.recordings:import_",
        "Import files from other tools.\n\n"
        "Example: groundtrace import shots/*.dat -o line.mcap --truth picks.sgt",
    ),
    "info": (
        f"{HERE}.info:info",
        "Show what a recording contains: topics, rates, gaps, units, geometry, truth, damage.\n\n"
        "Example: groundtrace info walk.mcap",
    ),
    "replay": (
        f"{HERE}.replay:replay",
        "Stream a recording through a pipeline; show and store what was decided.\n\n"
        "Without a recording, the bundled walk through a room is replayed. Without options it "
        "leaves NAME.rrd, for the viewer, and NAME.results.mcap, for the score, in the present "
        "folder.\n\n"
        "Example: groundtrace replay walk.mcap --pipeline waist-steps --set steps.score=0.3",
    ),
    "score": (
        f"{HERE}.score:score",
        "Score results against truth, with chance levels.\n\n"
        "Example: groundtrace score walk.results.mcap --tolerance 0.1",
    ),
    "why": (
        f"{HERE}.why:why",
        "Explain every missed and false step: the first gate that failed, by how much, and the "
        "smallest change of one parameter that mends it, with what else it changes.\n\n"
        "Example: groundtrace why walk.results.mcap --step 30 --rrd step30.rrd",
    ),
    "figure": (
        f"{HERE}.figure:figure",
        "Draw one moment for print: the signal with its steps, and the value of each gate of the "
        "candidate there.\n\n"
        "Example: groundtrace figure walk.results.mcap --step 30 -o step30.svg",
    ),
    "compare": (
        f"{HERE}.compare:compare",
        "Compare two results of one recording, decision by decision: the gate that set each "
        "difference, the parameters that differ, and whether the difference is significant.\n\n"
        "Example: groundtrace compare before.results.mcap after.results.mcap",
    ),
    "sweep": (
        f"{HERE}.sweep:sweep",
        "Try many settings of the gates, without the signal, and report the best with confidence "
        "intervals, and what missed steps cost in false ones. Parameters of the signal "
        "path are measured again. With several recordings each is left out in turn.\n\n"
        "Example: groundtrace sweep walk.results.mcap --grid steps.score=0.1:0.6:17 "
        "--grid steps.apart=0.1:0.5:19 --write best.toml --figure sweep.svg",
    ),
    "calibrate": (
        f"{HERE}.layout:calibrate",
        "Estimate from all impacts how waves travel over the floor and how far the sensors' clocks "
        "differ, with or without known places; report what cannot be estimated. Or, by a walk of "
        "so many metres (--distance 114), how long the steps of a walker are.\n\n"
        "Example: groundtrace calibrate room.results.mcap --geometry-out calibrated.toml",
    ),
    "annotate": (
        f"{HERE}.annotate:annotate",
        "Mark what happened in a recording: missed and false steps, steps, picks, notes, spans; "
        "on the command line, or on a page in the browser. Kept beside the recording at once, "
        "shown by replay, and truth for score where the recording has none.\n\n"
        "Example: groundtrace annotate walk.mcap --add missed@12.34 --note 'left foot, soft'",
    ),
    "share": (
        f"{HERE}.share:share",
        "Write a folder, a .zip or one .html page that shows a result to others, offline and "
        "without groundtrace: replay, summary with figures, score, annotations, pipeline.\n\n"
        "Example: groundtrace share walk.results.mcap -o for-bea",
    ),
    "export": (
        f"{HERE}.recordings:export_",
        "Write events of a result for other tools: CSV, Parquet, QuakeML, GeoJSON, GPX, Audacity "
        "labels; the signals of a recording as miniSEED, CSV or Parquet.\n\n"
        "Example: groundtrace export walk.results.mcap -o steps.csv --kind steps",
    ),
    "cut": (
        f"{HERE}.recordings:cut_",
        "Copy a span of a recording, cut to the sample; labels, geometry, attachments stay.\n\n"
        "Example: groundtrace cut walk.mcap -o turn.mcap --from 12.5 --to 20",
    ),
    "filter": (
        f"{HERE}.recordings:filter_",
        "Copy some topics of a recording, message by message as they are.\n\n"
        "Example: groundtrace filter walk.mcap -o small.mcap --without '/baro/*'",
    ),
    "convert": (
        f"{HERE}.recordings:convert",
        "Copy a recording with another compression, chunks or blocks; no sample changes.\n\n"
        "Example: groundtrace convert walk.mcap -o walk-lz4.mcap --compression lz4 --chunk-kb 1024",
    ),
    "fleet": (
        f"{HERE}.fleet:fleet",
        "Take many recordings through some pipelines, into one table: a row for each recording, "
        "and one for each step; on this computer, on a cluster, in shards; resumable.\n\n"
        "Example: groundtrace fleet walks/ --pipeline waist-steps -o walks.parquet",
    ),
    "fleet-report": (
        f"{HERE}.fleet:fleet_report",
        "Show a fleet's table as a page: distributions, the worst recordings first with what "
        "opens each miss, causes of misses, errors, and what changed against an earlier table.\n\n"
        "Example: groundtrace fleet-report walks.parquet -o walks.html --against before.parquet",
    ),
    "merge": (
        f"{HERE}.merge:merge",
        "Put several recordings into one file on one clock, e.g. a seismic and an IMU recording of "
        "the same walk: offset and drift of the clocks given, or found from the steps of both.\n\n"
        "Example: groundtrace merge room.mcap walk.mcap -o both.mcap",
    ),
    "doctor": (
        f"{HERE}.doctor:doctor",
        "Check a damaged recording: what can be read, and exactly what is missing; write a sound "
        "copy of all that can be read. Without a recording: what is installed, and what is "
        "missing.\n\n"
        "Example: groundtrace doctor torn.mcap --repair mended.mcap",
    ),
    "plugins": (
        f"{HERE}.plugins:plugins",
        "List what is installed by use: detect, locate, track, import, export, show.\n\n"
        "Example: groundtrace plugins --parameters",
    ),
    "pipelines": (
        f"{HERE}.plugins:pipelines",
        "List the shipped pipelines, or print one with all its parameters.\n\n"
        "Example: groundtrace pipelines waist-steps > mine.toml",
    ),
}
SIMULATIONS = {
    "room": (
        f"{HERE}.simulate:room",
        "Footsteps on a concrete floor with seismic sensors; steps, places, arrivals known.\n\n"
        "Example: groundtrace simulate room -o room.mcap --seed 7 --steps 40",
    ),
    "walk": (
        f"{HERE}.simulate:walk",
        "A walker with an IMU; steps of four types, turns, stops, places and headings known.\n\n"
        "Example: groundtrace simulate walk -o walk.mcap --path loop --types --seed 7",
    ),
    "vehicle": (
        f"{HERE}.simulate:vehicle",
        "Vehicles that pass geophones beside a road; passes, ways and speeds known.\n\n"
        "Example: groundtrace simulate vehicle -o cars.mcap --layout stations --passes 5 --overlap",
    ),
    "line": (
        f"{HERE}.simulate:line",
        "Shots on a line of geophones over layered ground; shots, triggers, arrivals known.\n\n"
        "Example: groundtrace simulate line -o line.mcap --random --seed 7",
    ),
}
ANALYSES = {
    "room": (
        f"{HERE}.layout:room",
        "Predict the location error of a sensor layout: errors over the room, sign errors, "
        "ambiguous regions, what each sensor contributes, where one more would help.\n\n"
        "Example: groundtrace analyze room room.toml --sigma-ms 0.5 --png room.png",
    ),
    "attenuation": (
        f"{HERE}.layout:attenuation",
        "Fit how amplitude falls with distance, out of steps or impacts of known place.\n\n"
        "Example: groundtrace analyze attenuation walk.mcap",
    ),
}


def application() -> App:
    """Return the command line's application."""
    app = App(
        name="groundtrace",
        version=_version,
        help_format="plaintext",  # markdown would need 70 ms more to start
        error_formatter=_usage_panel,
        help="Replay field recordings of footsteps and vehicles, "
        "and see why every detector decided as it did.",
    )
    for name, (target, text) in COMMANDS.items():
        app.command(target, name=name, help=text)
    simulate = App(
        name="simulate",
        help="Make a recording with known truth.\n\n"
        "Example: groundtrace simulate room -o room.mcap --seed 7",
    )
    for name, (target, text) in SIMULATIONS.items():
        simulate.command(target, name=name, help=text)
    app.command(simulate)
    analyze = App(
        name="analyze",
        help="Predict the location error of a sensor layout; fit how a floor attenuates.\n\n"
        "Example: groundtrace analyze room room.toml",
    )
    for name, (target, text) in ANALYSES.items():
        analyze.command(target, name=name, help=text)
    app.command(analyze)
    app.register_install_completion_command(
        help="Install completion of commands and options for the present shell."
    )
    return app


def _usage_panel(error: CycloptsError) -> Any:
    """Return what is wrong with the arguments, one of which may be the name of another's file."""
    from cyclopts.panel import CycloptsPanel

    from ..visible import visible

    return CycloptsPanel(visible(str(error)))


def _version() -> str:
    from ..runtime import installed_version

    return installed_version()


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line; exit as :class:`.exit_codes.ExitCode` says."""
    leave_working_folder()
    end_as_interrupted()
    limit_blas_threads()  # before a command imports numpy
    raise_malloc_trim()
    _say_what_the_console_can()
    try:
        code = _run(arguments)
        for stream in (sys.stdout, sys.stderr):
            if stream is not None:  # None where the caller has closed it
                stream.flush()
    except BrokenPipeError:  # who reads our output, as head does, has seen enough
        _hush()
        code = ExitCode.ERROR
    except OSError as error:
        from ..pipeline.results import NO_ROOM

        if error.errno not in NO_ROOM:
            raise
        from .console import print_stderr

        _hush()
        reason = f"expected room to write, found: {error.strerror}"
        with suppress(OSError):  # it may be the one that has no room
            print_stderr(f"groundtrace: output: {reason}")
        _hush()
        code = ExitCode.ERROR
    if code:
        sys.exit(code)


def _say_what_the_console_can() -> None:
    """Let letters that the console has not be told by their number: one of Windows has 256."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            with suppress(OSError):  # what waits to be written has no reader, which is said later
                stream.reconfigure(errors="backslashreplace")


def _public(arguments: Sequence[str]) -> list[str]:
    """Return arguments without what is secret in URLs; what opens these is kept to open them."""
    if not any("://" in argument for argument in arguments):
        return list(arguments)
    from groundtrace_codecs.location import public_argument

    return [public_argument(argument) for argument in arguments]


def piped(arguments: Sequence[str]) -> list[str]:
    """Return arguments with the file that ``-`` stands for: the parser takes it for an option."""
    return ["/dev/stdin" if argument == "-" else argument for argument in arguments]


def _run(arguments: Sequence[str] | None) -> int:
    """Run the command line; say known errors in one line each, and return the exit code."""
    try:
        public = _public(sys.argv[1:] if arguments is None else arguments)
        if arguments is None:
            sys.argv[1:] = public
        code = application()(piped(public), exit_on_error=False, result_action="return_value")
    except CycloptsError:
        return ExitCode.USAGE
    except KeyboardInterrupt:
        return ExitCode.INTERRUPTED
    except OSError as error:
        if error.filename is None:
            raise
        message = f"{error.filename}: expected a file to use, found: {error.strerror}"
        ended = ExitCode.ERROR
    except Exception as error:
        if not is_known(error):
            raise
        message = str(error)
        ended = ExitCode.USAGE if is_usage(error) else ExitCode.ERROR
    else:
        return ExitCode.DONE if code is None else ExitCode(code)
    from .console import print_stderr

    for line in message.splitlines():
        print_stderr(f"groundtrace: {line}")
    return ended


def _hush() -> None:
    """Drop what a stream still holds where it takes no more: the interpreter's end would say so."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def is_known(error: Exception) -> bool:
    """Tell whether an error is one that is said in one line."""
    errors = sys.modules.get("groundtrace_codecs.errors")  # not loaded, none was raised
    return errors is not None and isinstance(error, errors.Error)


def is_usage(error: Exception) -> bool:
    """Tell whether an error is of how the command was asked."""
    errors = sys.modules.get("groundtrace.errors")
    return errors is not None and isinstance(error, errors.UsageError)
