"""``groundtrace calibrate``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import msgspec
from cyclopts import Parameter, validators

from groundtrace_codecs.geometry import Geometry
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S

from ..appearing import write_text
from ..errors import RecordingError
from ..pipeline import checked_pipeline
from ..results import RUN, read_results
from .output import existing, print_json, print_table, progress, say, writable
from .truth import truth_of, truth_of_recording

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from groundtrace_codecs.events import Event
    from groundtrace_codecs.labels import Label

    from ..calibrate import Calibration
    from ..pipeline import PipelineConfig

FLAG = Parameter(negative="")


@dataclass(frozen=True, slots=True)
class _Subject:
    """What is calibrated: events and truth of a recording, and its geometry.

    ``replayed`` gives the events with a geometry; where they come out of results, always the same.
    """

    name: str
    replayed: Callable[[Geometry], Sequence[Event]]
    again: bool
    pipeline: PipelineConfig
    geometry: Geometry | None
    labels: Sequence[Label]

    def exponent(self) -> float:
        """Return the exponent that the pipeline's localizers reckon with."""
        given = [
            s.parameters["exponent"] for s in self.pipeline.stage if "exponent" in s.parameters
        ]
        return float(given[-1]) if given else 4 / 3


def calibrate(
    source: Path,
    *,
    pipeline: str = "room-footsteps",
    geometry: Path | None = None,
    truth: Path | None = None,
    ignore_places: Annotated[bool, FLAG] = False,
    offsets: Literal["auto", "yes", "no"] = "auto",
    exponent: Annotated[float | None, Parameter(validator=validators.Number(gt=0, lte=2))] = None,
    geometry_out: Path | None = None,
    force: Annotated[bool, FLAG] = False,
    json: Annotated[bool, FLAG] = False,
) -> None:
    """Estimate from all impacts how waves travel over the floor and how far the clocks differ.

    Parameters
    ----------
    source
        A recording, which is replayed, with clocks that are off again until they settle; or results
        that groundtrace replay wrote, taken as they are.
    pipeline
        Name or TOML file to replay a recording with.
    geometry
        Geometry TOML instead of the recording's own.
    truth
        Truth instead of the recording's own: CSV or MCAP; steps and impacts with places count.
    ignore_places
        Take no notice of known places of impacts.
    offsets
        Whether the sensors' clocks are told: no takes them as the geometry has them; auto tells
        them where places of impacts are known and places held out of the fit show the offsets; yes
        is an error where they do not.
    exponent
        Of arrivals over distance, where they do not tell it: 4/3 for onsets on a thin plate, 1 for
        arrivals that are corrected for dispersion. Without it that of the pipeline's localizers.
    geometry_out
        Write the geometry with what was found here, as TOML for groundtrace replay --geometry.
    force
        Overwrite an existing file.
    json
        Print one JSON document.
    """
    from .. import calibrate as package

    checked_pipeline(pipeline)
    if geometry_out is not None:
        sources = [path for path in (source, geometry, truth) if path is not None]
        writable(geometry_out, force=force, sources=sources)
    subject = _subject(existing(source), pipeline, truth)
    site = subject.geometry if geometry is None else Geometry.from_toml(geometry)
    if site is None:
        raise RecordingError(
            f"{subject.name}: geometry: expected one in the recording or --geometry FILE, "
            f"found none"
        )
    presumed = subject.exponent() if exponent is None else exponent
    choices = package.Choices(ignore_places, offsets, presumed)
    if subject.again:
        found, site = package.calibrate_replaying(subject.replayed, site, subject.labels, choices)
    else:
        found = package.calibrate_once(subject.replayed(site), site, subject.labels, choices)
    if geometry_out is not None:
        text = package.calibrated_geometry(site, found).to_toml()
        write_text(geometry_out, text)
    if json:
        written = None if geometry_out is None else str(geometry_out)
        document = msgspec.to_builtins(found)
        print_json({"recording": subject.name} | document | {"geometry": written})
        return
    _print(found)
    if geometry_out is not None:
        print(f"geometry: {geometry_out} (use it with: groundtrace replay --geometry)")


def _subject(path: Path, pipeline: str, truth: Path | None) -> _Subject:
    from ..pipeline import load_pipeline, parse_pipeline

    with Recording.open(path) as opened:
        if RUN not in opened.metadata:
            labels = truth_of_recording(opened, path, truth)
            config, site = load_pipeline(pipeline), opened.geometry
            return _Subject(path.name, _replayer(path, config), True, config, site, labels)
    result = read_results(path)
    labels = truth_of(result, path, truth)
    config = parse_pipeline(result.provenance.pipeline.encode(), path.name)
    return _Subject(result.name, lambda _: result.events, False, config, result.geometry, labels)


def _replayer(path: Path, config: PipelineConfig) -> Callable[[Geometry], Sequence[Event]]:
    """Return what replays a recording with a geometry."""
    from ..engine import replay
    from ..explain.measuring import EventList
    from ..pipeline import build_pipeline
    from ..source import Source

    def replayed(geometry: Geometry) -> Sequence[Event]:
        kept = EventList()
        with Recording.open(path) as opened:
            chain = build_pipeline(config, geometry)
            first = opened.start_ns
            with progress((opened.end_ns - first) / NS_PER_S, "replaying") as show:
                replay(
                    Source(opened),
                    chain,
                    [kept],
                    progress=lambda time_ns: show((time_ns - first) / NS_PER_S),
                )
        return kept.events

    return replayed


def _print(c: Calibration) -> None:
    places = "known" if c.known_places else "unknown"
    print(f"{c.impacts} impacts of {places} places, {c.arrivals} arrivals at {c.sensors} sensors")
    u = c.unit.removesuffix("s")
    rows = [
        ("scale k", f"{c.scale.value:.4g}", f"{c.scale.deviation:.2g}", f"s/{u}^p"),
        ("exponent p", f"{c.exponent.value:.3f}", f"{c.exponent.deviation:.2g}", "1"),
        ("velocity", "-" if c.velocity is None else f"{c.velocity:.0f}", "", f"{c.unit}/s"),
        ("error of an arrival", f"{c.arrival_sigma_s * 1e3:.3f}", "", "ms"),
    ]
    print_table(("", "value", "deviation", "unit"), rows)
    spread = " ".join(f"{x.loss} {x.scale:.4g}/{x.exponent:.3f}" for x in c.losses)
    print(f"k/p by loss: {spread}")
    if c.offsets_estimated:
        clocks = [
            (o.channel, f"{o.offset_s * 1e3:+.3f}", f"{o.deviation_s * 1e3:.3f}") for o in c.offsets
        ]
        print_table(("clock", "ahead [ms]", "deviation"), clocks)
    if c.held_out_gain is not None and c.held_out_error is not None:
        print(
            f"held-out places: log likelihood {c.held_out_gain:+.1f} with offsets of the clocks, "
            f"standard error {c.held_out_error:.1f}"
        )
    if c.positions is not None:
        p = c.positions
        print(
            f"places: RMSE {p.rmse_before:.2f} {c.unit} before, {p.rmse_after:.2f} {c.unit} after, "
            f"n {p.n}"
        )
    for note in c.notes:
        say(f"warning: {note}")
