"""``groundtrace simulate room``, ``walk``, ``vehicle`` and ``line``."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from groundtrace_codecs.geometry import Geometry
from groundtrace_codecs.recording import Recording

from ..api.files import existing_file, existing_recording, writable
from ..errors import SimulationError

# the names of choices (PlacementName and others) are read at run time, by the command line
from ..simulate.gait import (
    PlacementName,
    RouteName,
    WalkOptions,
)
from ..simulate.line import LineOptions, SourceName, simulate_line
from ..simulate.recording import Simulation, write
from ..simulate.road import (
    LayoutName,
    VehicleOptions,
)
from ..simulate.room import simulate_room
from ..simulate.room_plan import (
    PathName,
    RoomOptions,
    ShoeName,
)
from ..simulate.vehicle import simulate_vehicle
from ..simulate.walk import ClockError, Walked, simulate_same_walk, simulate_walk
from ..simulate.wave_laws import LawName
from .console import print_json, print_line
from .options import FLAG, OUT, Force, Json, Texts


def room(
    *,
    out: Annotated[Path, OUT],
    seed: int = 1,
    duration_s: float | None = None,
    channels: int | None = None,
    rate_hz: float = 20000.0,
    steps: int | None = None,
    snr: float = 100.0,
    geometry: Path | None = None,
    side_m: str = "",
    thickness_m: float | None = None,
    dispersion_m2s: float | None = None,
    loss_s: float | None = None,
    shoe: ShoeName | None = None,
    walls: float | None = None,
    resonances: Annotated[bool, FLAG] = False,
    path: PathName | None = None,
    walkers: int | None = None,
    impacts: Annotated[bool, FLAG] = False,
    clock_offset_ms: Texts = None,
    clock_spread_ms: float | None = None,
    dead: Texts = None,
    clipped: Texts = None,
    triaxial: Annotated[bool, FLAG] = False,
    wave_law: LawName | Literal["any"] | None = None,
    speed_mps: float | None = None,
    uneven: float | None = None,
    gain_spread: float | None = None,
    clip_at: float | None = None,
    precursor_ms: float | None = None,
    bursts: float | None = None,
    random: Annotated[bool, FLAG] = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Make footsteps on a floor with seismic sensors; steps, places and arrivals known.

    Parameters
    ----------
    out
        The recording to write.
    seed
        Of everything random.
    duration_s
        Length [s]; as many steps as fit. Without it and --steps: 20 steps in 13 s.
    channels
        Number of sensors, 3 to 16; 9 where nothing else says how many.
    rate_hz
        Sampling rate [Hz], from 1000.
    steps
        Number of steps of each walker, or of impacts; the length follows.
    snr
        Peak of a step at 1 m over the standard deviation of the noise.
    geometry
        Geometry TOML: outline of the room, convex or not, and sensors.
    side_m
        Side of a room without --geometry, as 6, or sides along x and y, as 6x4 [m]; 5.4.
    thickness_m
        Thickness of the concrete slab, 0.05 to 1 m; 0.2.
    dispersion_m2s
        Dispersion constant of the slab, 46 to 913 m2/s, in place of its thickness.
    loss_s
        Loss theta of the slab, 1e-6 to 1e-3 s; 1e-5.
    shoe
        What the steps are made with: heel, bare (softer, lower) or mixed; heel.
    walls
        Reflection of the amplitude at the outline, 0 to 0.9; 0.
    resonances
        Give each sensor a resonance of its mounting, 150 to 600 Hz.
    path
        Where people walk; u, or crossing for two.
    walkers
        1, or 2 who cross in the middle.
    impacts
        Single impacts at random places, 1 to 3 s apart, instead of steps.
    clock_offset_ms
        A sensor whose samples are stamped late, as G2=5 [ms]; may be given several times.
    clock_spread_ms
        Standard deviation of random clock offsets of all other sensors [ms].
    dead
        A sensor that gives 0 all the time; may be given several times.
    clipped
        A sensor with so much gain that most steps clip; may be given several times.
    triaxial
        Make every sensor G1 a station of three channels, G1x, G1y and G1z.
    wave_law
        How waves run: plate (a concrete slab), velocity that grows with the power 0.5, 0.3, 0 or
        -0.3 of frequency (f0.5, f0.3, f0, f-0.3), layered ground, or any of them, drawn with
        speed, gains, clipping, precursors and bursts; plate.
    speed_mps
        Phase velocity at 100 Hz, where waves are not those of a plate; drawn, 250 to 700 m/s.
    uneven
        By how much waves are slower here than there: standard deviation of the logarithm of
        their slowness, which differs over 2 m, 0 to 0.5; 0.
    gain_spread
        Standard deviation of the logarithm of the sensors' gains, 0 to 1; 0.
    clip_at
        Full scale of all channels over the peak of a mean step at 1 m; none clips.
    precursor_ms
        Weak waves of the same source come up to so long before each strike, to 100 ms; 0.
    bursts
        Slamming doors and rumbles a minute that are no steps; 0.
    random
        Draw what is not given of room, sensors, floor, shoe, walls and path from the seed.
    """
    options = RoomOptions(
        seed=seed,
        duration_s=duration_s,
        channels=channels,
        rate_hz=rate_hz,
        steps=steps,
        snr=snr,
        geometry=None
        if geometry is None
        else Geometry.from_toml(existing_file(geometry, "a geometry")),
        side_m=_sides(side_m) if side_m else None,
        thickness_m=thickness_m,
        dispersion_m2s=dispersion_m2s,
        loss_s=loss_s,
        shoe=shoe,
        walls=walls,
        resonances=resonances,
        path=path,
        walkers=walkers,
        impacts=impacts,
        clock_offset_s=tuple(_offset(text) for text in clock_offset_ms or ()),
        clock_spread_s=None if clock_spread_ms is None else clock_spread_ms / 1e3,
        dead=tuple(dead or ()),
        clipped=tuple(clipped or ()),
        triaxial=triaxial,
        wave_law=wave_law,
        speed_mps=speed_mps,
        uneven=uneven,
        gain_spread=gain_spread,
        clip_at=clip_at,
        precursor_s=None if precursor_ms is None else precursor_ms / 1e3,
        bursts=bursts,
        random=random,
    )
    store(simulate_room(options), out, force=force, json=json)


def walk(
    *,
    out: Annotated[Path, OUT],
    seed: int = 2,
    duration_s: float | None = None,
    rate_hz: float = 100.0,
    placement: PlacementName = "waist",
    path: RouteName | None = None,
    types: Annotated[bool, FLAG] = False,
    person: int | None = None,
    with_idle: Annotated[bool, FLAG] = False,
    gnss: Annotated[bool, FLAG] = False,
    disturbances: int | None = None,
    hard_iron_ut: float | None = None,
    soft_iron: float | None = None,
    steps_of: Path | None = None,
    clock_ahead_s: float = 0.0,
    clock_drift_ppm: float = 0.0,
    force: Force = False,
    json: Json = False,
) -> None:
    """Make a walker with an IMU, with steps, walking spans, headings and places known.

    Parameters
    ----------
    out
        The recording to write.
    seed
        Of everything random.
    duration_s
        Length [s]; once along the path, 120 of a random one, 60 without any other option.
    rate_hz
        Sampling rate of the IMU, 6 to 400 Hz.
    placement
        Where the IMU is worn; its axes lie ahead, left, up within 20 degrees at waist, trunk and
        foot (the right one), anyhow in the trouser pocket (phone) and at the wrist.
    path
        Where to walk; epfl is a loop of 260 m with strong magnetic disturbances on its second
        straight. Random, where --types, --person, --with-idle or --placement ask for a person
        other than the bundled recording's and no path is given.
    types
        Stop for backward, left and right steps on the way. The label of a step in the truth is
        its type then, and its foot a note. A side step is the lead foot's; its second contact
        is of kind trailing.
    person
        Seed of the person (cadence, vigour, manner, sensor), where not --seed.
    with_idle
        Stop for sitting down, reaching, handling the sensor, riding in a vehicle.
    gnss
        Add positions once a second.
    disturbances
        Number of stretches of 2 to 10 m that disturb the magnetic field by 10 to 60 uT.
    hard_iron_ut
        Constant field of the carrier in the sensor's axes [uT], 0 to 100.
    soft_iron
        By how much the carrier stretches the field along one axis, 0 to 0.3.
    steps_of
        A recording whose true steps are walked, e.g. a simulated room: the same walk as another
        sensor has it, for groundtrace merge. Its length and path hold.
    clock_ahead_s, clock_drift_ppm
        With --steps-of: how far the sensor's clock is ahead of the recording's at its start [s],
        and how much faster it runs [1e-6].
    """
    options = WalkOptions(
        seed=seed,
        duration_s=duration_s,
        rate_hz=rate_hz,
        placement=placement,
        path=path,
        types=types,
        person=person,
        with_idle=with_idle,
        gnss=gnss,
        disturbances=disturbances,
        hard_iron_t=None if hard_iron_ut is None else hard_iron_ut / 1e6,
        soft_iron=soft_iron,
    )
    if steps_of is None:
        if clock_ahead_s or clock_drift_ppm:
            raise SimulationError("--clock-ahead-s, --clock-drift-ppm: expected --steps-of with it")
        store(simulate_walk(options), out, force=force, json=json)
        return
    if path is not None or types or with_idle or duration_s is not None:
        raise SimulationError(
            "--steps-of: expected no --path, --types, --with-idle or --duration-s with it"
        )
    walked = _walked(existing_recording(steps_of))
    clock = ClockError(clock_ahead_s, clock_drift_ppm)
    store(simulate_same_walk(walked, options, clock), out, force=force, json=json)


def _walked(path: Path) -> Walked:
    """Return the true steps of a recording."""
    with Recording.open(path) as opened:
        steps = tuple(label for label in opened.labels if label.kind == "step")
        if not steps:
            raise SimulationError(f"{path.name}: expected true steps, found none")
        return Walked(path.name, steps, opened.start_ns, opened.end_ns)


def _sides(text: str) -> tuple[float, float]:
    """Read ``6`` or ``6x4``."""
    try:
        numbers = [float(part) for part in text.split("x")]
    except ValueError:
        numbers = []
    if len(numbers) not in (1, 2):
        raise SimulationError(f"--side-m: expected a side as 6 or 6x4, found {text!r}")
    return numbers[0], numbers[-1]


def _offset(text: str) -> tuple[str, float]:
    """Read ``G2=5`` [ms]."""
    name, _, number = text.partition("=")
    try:
        return name, float(number) / 1e3
    except ValueError:
        expected = "a sensor and its offset in ms as G2=5"
        raise SimulationError(f"--clock-offset-ms: expected {expected}, found {text!r}") from None


def store(simulation: Simulation, out: Path, *, force: bool, json: bool) -> None:
    """Write a simulation and say what its truth holds."""
    write(simulation, writable(out, force=force), force=force)
    kinds = [each.kind for each in simulation.labels]
    truth = {kind: kinds.count(kind) for kind in sorted(set(kinds))}
    if json:
        print_json({"path": str(out), "truth": truth})
    else:
        truth_text = ", ".join(f"{count} {kind}" for kind, count in truth.items())
        print_line(f"wrote {out}: {truth_text}")


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
    components: int | None = None,
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
    swells: int | None = None,
    stops: int | None = None,
    force: Force = False,
    json: Json = False,
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
        antennas: two lines of three geophones that the road crosses; stations: beside the road;
        nodes: a row of nodes whose ground, vehicles and noise the seed draws.
    geometry
        Geometry TOML with sensors, and the road where it has one, in place of a layout.
    stations
        How many, 2 to 4 (3), nodes 1 to 16 (3 to 5 drawn).
    spacing_m
        Between stations (20) or the geophones of an antenna (10) [m].
    components
        1: vertical, or 3: channels S1x, S1y and S1z of every sensor S1; 1, nodes 3.
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
        How many single impacts there are; of nodes, doors that slam.
    swells
        How many gusts and trucks far away nodes feel.
    stops
        How many of the vehicles stop on their way past nodes.
    """
    options = VehicleOptions(
        seed=seed,
        duration_s=duration_s,
        rate_hz=rate_hz,
        layout=layout,
        geometry=None
        if geometry is None
        else Geometry.from_toml(existing_file(geometry, "a geometry")),
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
        waypoints=tuple(_position(text) for text in waypoints.split()),
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
        swells=swells,
        stops=stops,
    )
    store(simulate_vehicle(options), out, force=force, json=json)


def _position(text: str) -> tuple[float, float]:
    return _pair("--waypoints", text, ",", "-100,5 20,5")


def _pair(option: str, text: str, between: str, example: str) -> tuple[float, float]:
    """Read two numbers."""
    try:
        first, second = (float(part) for part in text.split(between))
    except ValueError:
        raise SimulationError(f"{option}: expected it as {example}, found {text!r}") from None
    return first, second


def line(
    *,
    out: Annotated[Path, OUT],
    seed: int = 1,
    shots: int | None = None,
    channels: int | None = None,
    spacing_m: float | None = None,
    rate_hz: float | None = None,
    length_s: float | None = None,
    lead_s: float | None = None,
    source: SourceName | None = None,
    stack: int | None = None,
    layers: str = "",
    snr: float | None = None,
    late_ms: float | None = None,
    precursors: float | None = None,
    rumble: float | None = None,
    dead: Texts = None,
    flipped: Texts = None,
    random: Annotated[bool, FLAG] = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Make shots on a line of geophones; shots, triggers and arrivals known.

    Parameters
    ----------
    out
        The recording to write.
    seed
        Of everything random.
    shots
        How many, 1 to 50; 3.
    channels
        How many geophones, 4 to 96; 24.
    spacing_m
        Between geophones, 0.5 to 50 m; 5.
    rate_hz
        Sampling rate, 500 to 48000 Hz; 4000.
    length_s
        Of a record, 0.1 to 10 s; 0.5.
    lead_s
        Of a record before the trigger, 0 to 1 s; 0.
    source
        hammer, or drop: a falling weight, lower and stronger; hammer.
    stack
        How many blows are added up in a record, 1 to 50; 1.
    layers
        Thickness and speed of each layer, the last without end, as "3:400 8:1200 4000" [m:m/s];
        "3:400 1600".
    snr
        Swing of an arrival in the middle of those recorded, over the deviation of the noise; 20.
    late_ms
        By how much triggers come late, 0 to 50 ms; 0.
    precursors
        Size of what comes up to 0.1 s before a shot from its place, as a part of it, 0 to 0.2; 0.
    rumble
        Deviation of the surface waves of traffic over that of the noise, 0 to 20; 0.
    dead
        A geophone that gives nothing; may be given several times.
    flipped
        A geophone of the other polarity; may be given several times.
    random
        Draw what is not given of line, ground, source, noise and faults from the seed.
    """
    options = LineOptions(
        seed=seed,
        shots=shots,
        channels=channels,
        spacing_m=spacing_m,
        rate_hz=rate_hz,
        length_s=length_s,
        lead_s=lead_s,
        source=source,
        stack=stack,
        layers=tuple(_layer(text) for text in layers.split()),
        snr=snr,
        late_s=None if late_ms is None else late_ms / 1e3,
        precursors=precursors,
        rumble=rumble,
        dead=tuple(dead or ()),
        flipped=tuple(flipped or ()),
        random=random,
    )
    store(simulate_line(options), out, force=force, json=json)


def _layer(text: str) -> tuple[float, float]:
    """Read ``3:400`` or, of the last layer, ``1600``."""
    deep, colon, speed = text.partition(":")
    try:
        return (float(deep), float(speed)) if colon else (math.inf, float(deep))
    except ValueError:
        expected = 'layers as "3:400 1600"'
        raise SimulationError(f"--layers: expected {expected}, found {text!r}") from None
