"""The analysis of a layout: error maps, sign errors, ambiguous regions, contributions, advice."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from .advice import Advice, Trial, best_change, candidates, contributions
from .ambiguity import Ambiguity, ambiguity
from .error_maps import METHODS, ErrorMap, error_map
from .layout import Grid, Layout, grid_of
from .signs import SignErrors, sign_errors

if TYPE_CHECKING:
    from collections.abc import Callable

#: Layouts are compared on half as fine a lattice with half the draws, but at least this many; and
#: candidate places on one this coarse with this many draws.
TRIAL_LATTICE, TRIAL_DRAWS, SCREEN_LATTICE, SCREEN_DRAWS = 9, 16, 7, 12
#: Draws at the worst place for the law of wrong signs; cells along the room where it is drawn.
SIGN_DRAWS, RASTER = 20_000, 160
#: Cells of the map of wrong signs for each of the error maps: odd, so that middles stay.
FINER = 3


@dataclass(frozen=True, slots=True)
class Settings:
    """How thoroughly to analyse.

    Attributes
    ----------
    lattice
        Cells along the longer side of the room.
    draws
        Random errors at each.
    seed
        Of everything random.
    localizer
        Which one the advice is for: one of :data:`.error_maps.METHODS`.
    """

    lattice: int = 21
    draws: int = 50
    seed: int = 0
    localizer: str = "power-law"

    @property
    def trial(self) -> Trial:
        """How whole layouts are compared."""
        lattice = min(self.lattice, max(TRIAL_LATTICE, self.lattice // 2))
        return Trial(lattice, min(self.draws, max(TRIAL_DRAWS, self.draws // 2)), self.seed)

    @property
    def screen(self) -> Trial:
        """How candidate places are compared at first."""
        return Trial(min(self.lattice, SCREEN_LATTICE), min(self.draws, SCREEN_DRAWS), self.seed)


@dataclass(frozen=True, slots=True, eq=False)
class RoomAnalysis:
    """What is known of a layout before anyone records.

    Attributes
    ----------
    layout, remarks
        Sensors and room, and what was assumed of them.
    settings
        How thoroughly it was analysed.
    grid
        Where errors were computed.
    errors
        Of each localizer.
    sign_grid, signs
        Wrong signs, and where they were computed.
    raster, ambiguity
        Regions, and places to draw them at.
    contributions
        By how much the mean error rises without each sensor, by localizer [m]; empty where no
        sensor can be spared.
    advice
        Changes: one sensor more, and one moved.
    """

    layout: Layout
    remarks: tuple[str, ...]
    settings: Settings
    grid: Grid
    errors: tuple[ErrorMap, ...]
    sign_grid: Grid
    signs: SignErrors
    raster: Grid
    ambiguity: Ambiguity
    contributions: tuple[dict[str, float], ...]
    advice: tuple[Advice, ...]

    @property
    def best(self) -> ErrorMap:
        """Errors of the localizer that is best on average."""
        return min(self.errors, key=lambda errors: errors.mean_m)

    def worst(self, errors: ErrorMap) -> tuple[float, float]:
        """Return where a localizer is worst [m]."""
        x, y = self.grid.nodes[errors.rmse_m.argmax()]
        return float(x), float(y)


def analyze_room(
    layout: Layout,
    remarks: tuple[str, ...] = (),
    settings: Settings | None = None,
    show: Callable[[float], None] = lambda _: None,
) -> RoomAnalysis:
    """Analyse a layout.

    Parameters
    ----------
    layout, remarks
        Of :func:`groundtrace.analyze.layout.layout_of`.
    settings
        How thoroughly.
    show
        Called with the part of the work that is done, within [0, 1].
    """
    how = settings or Settings()
    done = _Steps(_work(layout), show)
    room = layout.room
    grid, fine, raster = (grid_of(room, n) for n in (how.lattice, FINER * how.lattice, RASTER))
    errors = []
    for method in METHODS:
        errors.append(error_map(layout, method, grid.nodes, how.draws, how.seed))
        done(MAP_STEPS)
    signs = sign_errors(layout.arrivals(fine.nodes), layout.sigma_s, SIGN_DRAWS, how.seed)
    regions = ambiguity(layout, raster, how.seed)
    before = how.trial.means_m(layout)
    spared = contributions(layout, how.trial, before, lambda: done(SPARED_STEPS))
    least = sorted(range(len(spared)), key=lambda i: spared[i][how.localizer])[:1]
    found = [
        best_change(layout, moved, how.localizer, how.screen, how.trial, before, lambda: done(1))
        for moved in (None, *least)
    ]
    advice = tuple(a for a in found if a is not None)
    show(1.0)
    return RoomAnalysis(
        layout, remarks, how, grid, tuple(errors), fine, signs, raster, regions, spared, advice
    )


#: What a map and leaving a sensor out cost, as candidates screened.
MAP_STEPS, SPARED_STEPS = 20, 6


def _work(layout: Layout) -> int:
    count = len(layout.sensors)
    return MAP_STEPS * len(METHODS) + SPARED_STEPS * count + 2 * len(candidates(layout))


class _Steps:
    """Counts work that is done."""

    def __init__(self, total: int, show: Callable[[float], None]) -> None:
        self._total, self._show, self._done = total, show, 0

    def __call__(self, steps: int) -> None:
        self._done += steps
        self._show(min(1.0, self._done / self._total))
