"""The findings of an analysis in sentences, for the terminal, the figures, and the viewer."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .error_maps import SMALL_M
from .layout import MIRRORED

if TYPE_CHECKING:
    from .advice import Advice
    from .error_maps import ErrorMap
    from .layout import Layout
    from .room import RoomAnalysis

#: Localizers as people write them.
NAMES = {"so-tdoa": "SO-TDOA", "hyperbolic": "hyperbolic", "power-law": "power law"}
#: A change counts where the mean error falls by more than this part of it.
WORTH = 0.02


def assumed(layout: Layout) -> str:
    """Return what was assumed of the floor and of the arrivals."""
    floor = "a = 183 m²/s" if layout.thickness_m is None else f"{layout.thickness_m:g} m thick"
    return (
        f"{len(layout.sensors)} sensors, arrivals ± {layout.sigma_s * 1e3:g} ms each, "
        f"theta {layout.theta_s:g} s, floor {floor}"
    )


def error_words(found: RoomAnalysis, errors: ErrorMap) -> str:
    """Return what an error map says."""
    x, y = found.worst(errors)
    small = float(np.mean(errors.rmse_m < SMALL_M))
    return (
        f"{NAMES[errors.method]}: mean {errors.mean_m:.2f} m, worst {errors.rmse_m.max():.2f} m "
        f"at ({x:.1f}, {y:.1f}); {small:.0%} of the room below {SMALL_M:g} m"
    )


def sign_words(found: RoomAnalysis) -> str:
    """Return what the map of wrong signs says."""
    signs = found.signs
    x, y = found.sign_grid.nodes[signs.physical.argmax()]
    return (
        f"wrong signs of {signs.pairs}: mean {signs.physical.mean():.2f}, worst "
        f"{signs.physical.max():.2f} at ({x:.1f}, {y:.1f}), where 95 % of steps have at most "
        f"{signs.most}"
    )


def region_words(found: RoomAnalysis) -> str:
    """Return which regions are ambiguous."""
    a = found.ambiguity
    total, areas = len(a.regions), a.regions.areas
    parts = [
        f"{int(which.sum())} {text} ({areas[which].sum() / areas.sum():.1%} of the area)"
        for which, text in (
            (a.tiny, "tiny"),
            (a.doubled, "like one far away"),
            (a.confused, "mostly taken for one beyond their neighbours"),
        )
        if which.any()
    ]
    if MIRRORED in found.remarks:
        parts.insert(0, "all the same on both sides of the sensors' line")
    said = ", ".join(parts) if parts else "none ambiguous"
    if np.isnan(a.confusion).all():
        return f"{total} regions: {said}; too many to try each"
    return (
        f"{total} regions: {said}; confused {np.average(a.confusion, weights=areas):.1%} of steps"
    )


def contribution_words(found: RoomAnalysis) -> str:
    """Return which sensors count most and least."""
    if not found.contributions:
        return "no sensor can be spared: three are needed to locate"
    rises = [without[found.settings.localizer] for without in found.contributions]
    most, least = int(np.argmax(rises)), int(np.argmin(rises))
    names = found.layout.sensors
    return (
        f"{names[most]} counts most (without it {NAMES[found.settings.localizer]} "
        f"{rises[most]:+.2f} m), {names[least]} least ({rises[least]:+.2f} m)"
    )


def advice_words(found: RoomAnalysis, advice: Advice) -> str:
    """Return what a change gains."""
    x, y = advice.place
    before, after = advice.before_m[advice.method], advice.after_m[advice.method]
    if advice.moved is None:
        what, verb = "one more sensor", "add one"
    else:
        what = f"moving {found.layout.sensors[advice.moved]}"
        verb = f"move {found.layout.sensors[advice.moved]}"
    means = f"mean error of {NAMES[advice.method]} {before:.2f} to {after:.2f} m"
    if advice.gain_m <= WORTH * before:
        return f"{what} gains little: best at ({x:.1f}, {y:.1f}), {means}"
    return f"{verb} to ({x:.1f}, {y:.1f}): {means} ({-advice.gain_m / before:+.0%})"


def findings(found: RoomAnalysis) -> list[str]:
    """Return all findings, one a line."""
    return [
        *(error_words(found, errors) for errors in found.errors),
        sign_words(found),
        region_words(found),
        contribution_words(found),
        *(advice_words(found, advice) for advice in found.advice),
    ]
