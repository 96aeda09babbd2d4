"""``groundtrace analyze`` and ``groundtrace calibrate``."""

from __future__ import annotations

import math
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import msgspec
from cyclopts import Parameter, validators

from ..api.calibration import attenuation_of, calibration_of, geometry_of, lengths_of
from ..api.files import OriginFile, mark_of, writable
from ..errors import UsageError
from ..layout.report import NAMES, assumed, findings, report
from ..pipeline.config import checked_pipeline
from ..pipeline.plugins import load
from ..pipeline.results import timeline_id, write_text
from .console import print_json, print_line, print_stderr, print_table, progress, where_to_show
from .options import FLAG, PIPELINE, POSITIVE, RECORDING, Force, ForceOutputs, Json, Spawn

if TYPE_CHECKING:
    from ..layout.analysis import RoomAnalysis
    from ..layout.attenuation import Attenuation
    from ..layout.calibrate import Calibration
    from ..layout.report import RoomReport


def room(
    geometry: Path,
    *,
    sigma_ms: Annotated[float, POSITIVE] = 0.5,
    theta_s: Annotated[float | None, POSITIVE] = None,
    localizer: Literal["so-tdoa", "hyperbolic", "power-law"] = "power-law",
    lattice: Annotated[int, Parameter(validator=validators.Number(gte=3, lte=201))] = 21,
    draws: Annotated[int, Parameter(validator=validators.Number(gte=2, lte=10_000))] = 50,
    seed: Annotated[int, Parameter(validator=validators.Number(gte=0))] = 0,
    png: Path | None = None,
    rrd: Path | None = None,
    spawn: Spawn = False,
    force: ForceOutputs = False,
    json: Json = False,
) -> None:
    """Predict the location error of a sensor layout, before anyone records.

    Parameters
    ----------
    geometry
        TOML with sensors, outline and medium, or a recording that has these.
    sigma_ms
        Standard deviation of each sensor's arrivals [ms].
    theta_s
        Time scale of the velocity law instead of the medium's [s].
    localizer
        Which one the advice is for.
    lattice
        Places along the longer side of the room.
    draws
        Random errors at each place.
    seed
        Of everything random.
    png
        Write the figure here, as PNG.
    rrd
        Write a viewer's file with the maps.
    """
    from ..layout.analysis import Settings, analyze_room, layout_of

    fallback = Path(f"{geometry.stem}.analysis.rrd")
    checked = partial(writable, force=force, sources=[geometry], of=lambda: OriginFile(geometry))
    if png is not None:
        checked(png)
        if png.suffix.lower() != ".png":
            raise UsageError(f"{png}: expected a name that ends in .png, found {png.name}")
    spawn, rrd = where_to_show(rrd, fallback, checked, spawn=spawn)
    site = geometry_of(geometry)
    layout, remarks = layout_of(site, geometry.name, sigma_ms * 1e-3, theta_s)
    how = Settings(lattice, draws, seed, localizer)
    with progress(100.0, "analysing", "%") as show:
        analysis = analyze_room(layout, remarks, how, lambda part: show(100.0 * part))
    if json:
        print_json(report(analysis))
    else:
        _print_room(analysis)
    for remark in remarks:
        print_stderr(f"remark: {remark}")
    _write(analysis, png, rrd, mark_of(timeline_id(geometry.name)), spawn=spawn)


def _print_room(analysis: RoomAnalysis) -> None:
    print_line(f"{analysis.layout.name}: {assumed(analysis.layout)}")
    for line in findings(analysis):
        print_line(f"  {line}")
    if analysis.contributions:
        print_line("\nmean error without each sensor, rise [m]")
        _print_sensors(report(analysis))


def _print_sensors(document: RoomReport) -> None:
    rows = [
        (s.name, f"{s.x_m:.2f}", f"{s.y_m:.2f}", *(f"{v:+.3f}" for v in s.contribution_m.values()))
        for s in document.sensors
        if s.contribution_m is not None
    ]
    print_table(("sensor", "x [m]", "y [m]", *NAMES.values()), rows)


def _write(
    analysis: RoomAnalysis, png: Path | None, rrd: Path | None, mark: str, *, spawn: bool
) -> None:
    if png is not None:
        from ..layout.report import save

        save(analysis, png, mark)
        print_stderr(f"figure: {png}")
    if rrd is not None or spawn:
        load("views", "room-analysis")(analysis, path=rrd, spawn=spawn)
    if rrd is not None:
        print_stderr(f"maps: {rrd} (open it with: rerun {rrd})")


def attenuation(
    recording: Annotated[Path, RECORDING],
    *,
    geometry: Path | None = None,
    truth: Path | None = None,
    json: Json = False,
) -> None:
    """Fit how amplitude falls with distance, out of impacts whose places are known.

    Parameters
    ----------
    recording
        With steps or impacts of known place, as truth of its own or by --truth.
    geometry
        Another geometry than the recording's.
    truth
        Places as CSV: time_s, kind (step or impact), x_m, y_m.
    """
    impacts, law = attenuation_of(recording, geometry, truth, print_stderr)
    if json:
        print_json({"recording": recording.name, "impacts": impacts, **asdict(law)})
    else:
        _print_attenuation(recording.name, impacts, law)


def _print_attenuation(name: str, impacts: int, law: Attenuation) -> None:
    print_line(f"{name}: {impacts} impacts, {law.samples} amplitudes above the noise")
    print_line("  amplitude = strength * d^-n * exp(-alpha d), each impact with its own strength")
    print_line(f"  n {law.exponent:.3f} +- {law.exponent_sigma:.3f}")
    print_line(f"  alpha {law.loss_per_m:.4f} +- {law.loss_sigma:.4f} 1/m")
    print_line(f"  scatter about it: a factor of {math.exp(law.scatter):.2f}")
    if law.correlation < -0.95:
        print_line("  n and alpha are hard to tell apart here: they hold together, not each alone")


def calibrate(
    source: Path,
    *,
    distance: Annotated[float | None, POSITIVE] = None,
    pipeline: Annotated[str | None, PIPELINE] = None,
    geometry: Path | None = None,
    truth: Path | None = None,
    ignore_places: Annotated[bool, FLAG] = False,
    offsets: Literal["auto", "yes", "no"] = "auto",
    exponent: Annotated[float | None, Parameter(validator=validators.Number(gt=0, lte=2))] = None,
    geometry_out: Path | None = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Estimate how waves travel over a floor, or how long a walker's steps are.

    Without --distance all impacts tell how waves travel and how far the clocks differ; with it a
    walk of known distance tells the constants of every model of step length.

    Parameters
    ----------
    source
        A recording, which is replayed, with clocks that are off again until they settle; or results
        that groundtrace replay wrote, taken as they are.
    distance
        What was walked in the whole recording [m]: calibrates the lengths of steps.
    pipeline
        Name or TOML file to replay a recording with: room-footsteps, or pedestrian with --distance.
    geometry
        Geometry TOML instead of the recording's own.
    truth
        Truth instead of the recording's own: CSV or MCAP; steps and impacts with places count.
    ignore_places
        Ignore known impact positions.
    offsets
        Whether the sensors' clocks are told: no takes them as the geometry has them; auto tells
        them where places of impacts are known and places held out of the fit show the offsets; yes
        is an error where they do not.
    exponent
        Of arrivals over distance, where they do not tell it: 4/3 for onsets on a thin plate, 1 for
        arrivals that are corrected for dispersion. Without it that of the pipeline's localizers.
    geometry_out
        Write the geometry with what was found here, as TOML for groundtrace replay --geometry.
    """
    pipeline = pipeline or ("room-footsteps" if distance is None else "pedestrian")
    checked_pipeline(pipeline)
    if distance is not None:
        _calibrate_lengths(source, distance, pipeline, json=json)
        return
    if geometry_out is not None:
        sources = [path for path in (source, geometry, truth) if path is not None]
        writable(geometry_out, force=force, sources=sources)
    done = calibration_of(
        source,
        pipeline,
        geometry,
        truth,
        ignore_places=ignore_places,
        offsets=offsets,
        exponent=exponent,
        report=print_stderr,
        progress=progress,
    )
    if geometry_out is not None:
        write_text(geometry_out, done.geometry.to_toml())
    if json:
        written = None if geometry_out is None else str(geometry_out)
        document = msgspec.to_builtins(done.calibration)
        print_json({"recording": done.name} | document | {"geometry": written})
        return
    _print_calibration(done.calibration)
    if geometry_out is not None:
        print_line(f"geometry: {geometry_out} (use it with: groundtrace replay --geometry)")


#: What lengths that were calibrated are still off by together, as a part. Bench:
#: pedestrian_accuracy.py -> 0.8 % on other walks of the same simulated people; real paces vary.
CALIBRATED = 0.03


def _calibrate_lengths(source: Path, distance_m: float, pipeline: str, *, json: bool) -> None:
    """Tell the constants of step lengths by a walk of known distance."""
    name, calibration = lengths_of(source, distance_m, pipeline, progress)
    if json:
        print_json({"recording": name} | msgspec.to_builtins(calibration))
        return
    print_line(
        f"{name}: {calibration.steps} steps over {calibration.distance_m:g} m: "
        f"{calibration.length_m:.3f} m each, "
        f"{calibration.cadence_hz:.2f} a second, {calibration.speed_mps:.2f} m/s"
    )
    rows = [
        (
            one.model,
            f"{one.before_m:.1f}",
            f"{100 * (one.before_m / calibration.distance_m - 1):+.1f} %",
            ", ".join(f"{name} {value:.4g}" for name, value in one.constants.items()),
            f"{100 * one.spread:.1f} %",
        )
        for one in calibration.models
    ]
    print_table(("model", "by default [m]", "off", "calibrated", "scatter of steps"), rows)
    settings = " ".join(
        f"--set track.{n}={v:.4g}" for n, v in calibration.models[-1].constants.items()
    )
    settings += f" --set track.scale_error={CALIBRATED:g}"
    print_line(f"use it with: groundtrace replay REC.mcap --pipeline {pipeline} {settings}")


def _print_calibration(c: Calibration) -> None:
    places = "known" if c.known_places else "unknown"
    print_line(
        f"{c.impacts} impacts of {places} places, {c.arrivals} arrivals at {c.sensors} sensors"
    )
    u = c.unit.removesuffix("s")
    rows = [
        ("scale k", f"{c.scale.value:.4g}", f"{c.scale.deviation:.2g}", f"s/{u}^p"),
        ("exponent p", f"{c.exponent.value:.3f}", f"{c.exponent.deviation:.2g}", "1"),
        ("velocity", "-" if c.velocity is None else f"{c.velocity:.0f}", "", f"{c.unit}/s"),
        ("error of an arrival", f"{c.arrival_sigma_s * 1e3:.3f}", "", "ms"),
    ]
    print_table(("", "value", "deviation", "unit"), rows)
    spread = " ".join(f"{x.loss} {x.scale:.4g}/{x.exponent:.3f}" for x in c.losses)
    print_line(f"k/p by loss: {spread}")
    if c.offsets_estimated:
        clocks = [
            (o.channel, f"{o.offset_s * 1e3:+.3f}", f"{o.deviation_s * 1e3:.3f}") for o in c.offsets
        ]
        print_table(("clock", "ahead [ms]", "deviation"), clocks)
    if c.held_out_gain is not None and c.held_out_error is not None:
        print_line(
            f"held-out places: log likelihood {c.held_out_gain:+.1f} with offsets of the clocks, "
            f"standard error {c.held_out_error:.1f}"
        )
    if c.positions is not None:
        p = c.positions
        print_line(
            f"places: RMSE {p.rmse_before:.2f} {c.unit} before, {p.rmse_after:.2f} {c.unit} after, "
            f"n {p.n}"
        )
    for note in c.notes:
        print_stderr(f"warning: {note}")
