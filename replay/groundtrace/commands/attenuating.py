"""``groundtrace analyze attenuation``."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from groundtrace_codecs.geometry import Geometry
from groundtrace_codecs.recording import Recording

from ..analyze.amplitudes import amplitudes, impacts_of
from ..analyze.attenuation import Attenuation, fit_attenuation
from ..errors import RecordingError
from .output import existing, print_json
from .truth import truth_of_recording


def attenuation(
    recording: Path,
    *,
    geometry: Path | None = None,
    truth: Path | None = None,
    json: Annotated[bool, Parameter(negative="")] = False,
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
    json
        Print one JSON document.
    """
    path = existing(recording)
    with Recording.open(path) as opened:
        site = Geometry.from_toml(existing(geometry, "a geometry")) if geometry else opened.geometry
        impacts = impacts_of(truth_of_recording(opened, path, truth))
        if site is None or len(site.sensors) < 2:
            raise RecordingError(f"{path.name}: expected a geometry with sensors, found none")
        if not impacts:
            raise RecordingError(
                f"{path.name}: expected steps or impacts of known place (its truth, or --truth "
                f"FILE), found none"
            )
        found = fit_attenuation(*amplitudes(opened, site, impacts))
    if found is None:
        raise RecordingError(
            f"{path.name}: expected two sensors or more above the noise at several distances, "
            f"found {len(impacts)} impacts that tell too little"
        )
    if json:
        print_json({"recording": path.name, "impacts": len(impacts), **asdict(found)})
    else:
        _print(path.name, len(impacts), found)


def _print(name: str, impacts: int, law: Attenuation) -> None:
    print(f"{name}: {impacts} impacts, {law.samples} amplitudes above the noise")
    print("  amplitude = strength * d^-n * exp(-alpha d), each impact with its own strength")
    print(f"  n {law.exponent:.3f} +- {law.exponent_sigma:.3f}")
    print(f"  alpha {law.loss_per_m:.4f} +- {law.loss_sigma:.4f} 1/m")
    print(f"  scatter about it: a factor of {math.exp(law.scatter):.2f}")
    if law.correlation < -0.95:
        print("  n and alpha are hard to tell apart here: they hold together, not each alone")
