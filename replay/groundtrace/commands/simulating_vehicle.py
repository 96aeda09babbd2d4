"""``groundtrace simulate vehicle``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from groundtrace_codecs.geometry import Geometry

from ..errors import SimulationError
from ..simulate import VehicleOptions, simulate_vehicle

# read by the command line at run time, like the types above
from ..simulate.vehicle_options import LayoutName  # noqa: TC001
from .output import existing
from .simulating import FLAG, OUT, store


def vehicle(
    *,
    out: Annotated[Path, OUT],
    seed: int = 1,
    duration_s: float | None = None,
    rate_hz: float = 200.0,
    layout: LayoutName = "antennas",
    geometry: Path | None = None,
    stations: int | None = None,
    spacing_m: float | None = None,
    components: int = 1,
    passes: int = 1,
    overlap: Annotated[bool, FLAG] = False,
    speed_mps: float | None = None,
    end_speed_mps: float | None = None,
    offset_m: float | None = None,
    heading_deg: float | None = None,
    radius_m: float | None = None,
    waypoints: Annotated[str, Parameter(allow_leading_hyphen=True)] = "",
    velocity_mps: float = 250.0,
    exponent: float = 1.5,
    loss_spm: float = 0.0,
    coherence_m: float | None = None,
    band_hz: str = "",
    engine_hz: float | None = None,
    snr: float = 10.0,
    level_spread_db: float | None = None,
    wind: float = 0.0,
    gain_spread: float = 0.0,
    geophone_hz: float | None = None,
    walkers: int = 0,
    impacts: int = 0,
    force: Annotated[bool, FLAG] = False,
) -> None:
    """Make vehicles that pass sensors beside a road; passes, ways, speeds and levels known.

    Parameters
    ----------
    out
        The recording to write.
    seed
        Of everything random.
    duration_s
        Length [s]; 30 for each pass.
    rate_hz
        Sampling rate, 50 to 1000 Hz.
    layout
        antennas: two lines of three geophones that the road crosses; stations: beside the road.
    geometry
        Geometry TOML with sensors, and the road where it has one, in place of a layout.
    stations
        How many, 2 to 4; 3.
    spacing_m
        Between stations (20) or the geophones of an antenna (10) [m].
    components
        1: vertical, or 3: channels S1x, S1y and S1z of every sensor S1.
    passes
        How many vehicles pass; several come at random times, from both sides, on two lanes.
    overlap
        The second and the first of several pass within two seconds, against each other.
    speed_mps
        2 to 30 m/s; 10 for one vehicle, 8 to 20 drawn for each of several.
    end_speed_mps
        What the speed of a single vehicle changes to, evenly over the recording.
    offset_m
        Of the road from the middle of the sensors, to the road's left [m]; 5, antennas 1.
    heading_deg
        Of the road, counter-clockwise from x; 0, antennas 75.
    radius_m
        Of a road that bends to the left, or, negative, to the right [m].
    waypoints
        Corners of the road, as "-100,5 20,5 80,60" [m].
    velocity_mps
        Of the waves, 80 to 3000 m/s.
    exponent
        n of the power mu / r^n, 0.5 to 6.
    loss_spm
        rho of the ground's loss exp(-2 rho pi f r) of power [s/m], to 0.01.
    coherence_m
        Fade by multipath, over this way of the vehicle [m].
    band_hz
        Of the vehicles' noise, as 10-40.
    engine_hz
        Give each vehicle tones: the firing rate of its engine.
    snr
        Root of the mean power of a vehicle at 10 m over the noise.
    level_spread_db
        Standard deviation of the vehicles' levels [dB]; 0 for one vehicle, 3 for several.
    wind
        Root of the mean power of wind, 0.5 to 8 Hz, over that of the noise.
    gain_spread
        Standard deviation of the logarithm of the sensors' gains.
    geophone_hz
        Natural frequency of the geophones; without it they feel all frequencies alike.
    walkers
        How many people walk by.
    impacts
        How many single impacts there are.
    force
        Overwrite an existing file.
    """
    options = VehicleOptions(
        seed=seed,
        duration_s=duration_s,
        rate_hz=rate_hz,
        layout=layout,
        geometry=None if geometry is None else Geometry.from_toml(existing(geometry, "a geometry")),
        stations=stations,
        spacing_m=spacing_m,
        components=components,
        passes=passes,
        overlap=overlap,
        speed_mps=speed_mps,
        end_speed_mps=end_speed_mps,
        offset_m=offset_m,
        heading_deg=heading_deg,
        radius_m=radius_m,
        waypoints=tuple(_place(text) for text in waypoints.split()),
        velocity_mps=velocity_mps,
        exponent=exponent,
        loss_spm=loss_spm,
        coherence_m=coherence_m,
        band_hz=_pair("--band-hz", band_hz, "-", "10-40") if band_hz else None,
        engine_hz=engine_hz,
        snr=snr,
        level_spread_db=level_spread_db,
        wind=wind,
        gain_spread=gain_spread,
        geophone_hz=geophone_hz,
        walkers=walkers,
        impacts=impacts,
    )
    store(simulate_vehicle(options), out, force=force)


def _place(text: str) -> tuple[float, float]:
    return _pair("--waypoints", text, ",", "-100,5 20,5")


def _pair(option: str, text: str, between: str, example: str) -> tuple[float, float]:
    """Read two numbers."""
    try:
        first, second = (float(part) for part in text.split(between))
    except ValueError:
        raise SimulationError(f"{option}: expected it as {example}, found {text!r}") from None
    return first, second
