"""``groundtrace simulate``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from ..simulate import RoomOptions, Simulation, WalkOptions, simulate_room, simulate_walk, write
from .output import writable

if TYPE_CHECKING:
    from collections.abc import Sequence

OUT = Parameter(name=["--out", "-o"])
FLAG = Parameter(negative="")


def room(
    *,
    out: Annotated[Path, OUT],
    seed: int = 1,
    duration_s: float | None = None,
    channels: int = 9,
    rate_hz: float = 20000.0,
    steps: int | None = None,
    snr: float = 100.0,
    force: Annotated[bool, FLAG] = False,
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
        Number of sensors, 3 to 16.
    rate_hz
        Sampling rate [Hz].
    steps
        Number of steps; the length follows.
    snr
        Peak of a step at 1 m over the standard deviation of the noise.
    force
        Overwrite an existing file.
    """
    options = RoomOptions(
        seed=seed, duration_s=duration_s, channels=channels, rate_hz=rate_hz, steps=steps, snr=snr
    )
    _write(simulate_room(options), out, force=force)


def walk(
    *,
    out: Annotated[Path, OUT],
    seed: int = 2,
    duration_s: float = 60.0,
    rate_hz: float = 100.0,
    force: Annotated[bool, FLAG] = False,
) -> None:
    """Make a walker with an IMU at the waist, with steps, walking spans and turns known.

    Parameters
    ----------
    out
        The recording to write.
    seed
        Of everything random.
    duration_s
        Length [s].
    rate_hz
        Sampling rate of the IMU, 6 to 400 Hz.
    force
        Overwrite an existing file.
    """
    options = WalkOptions(seed=seed, duration_s=duration_s, rate_hz=rate_hz)
    _write(simulate_walk(options), out, force=force)


def _write(simulation: Simulation, out: Path, *, force: bool) -> None:
    write(simulation, writable(out, force=force), force=force)
    print(f"wrote {out}: {_labels([x.kind for x in simulation.labels])}")


def _labels(kinds: Sequence[str]) -> str:
    return ", ".join(f"{kinds.count(kind)} {kind}" for kind in sorted(set(kinds)))
