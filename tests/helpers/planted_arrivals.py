"""Evidence of places made of arrivals alone, with faults planted in them: no signal is needed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace.explain.why_places import PlaceExplainer
from groundtrace.pipeline.config import parse_pipeline
from groundtrace.pipeline.gates import Candidates, gate_specs
from groundtrace.pipeline.parameters import build
from groundtrace.pipeline.plugins import stage_named
from groundtrace.pipeline.results import Evidence, StageEvidence
from groundtrace.pipeline.stage import Frames, emitted
from groundtrace_codecs.events import SIMULATOR, Label, StageSpec
from groundtrace_codecs.geometry import Geometry, Medium, Sensor
from groundtrace_codecs.signals import NS_PER_S

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from groundtrace.explain.why_places import PlaceAccount

    Array = NDArray[np.float64]

START_NS = 1_767_603_600 * NS_PER_S
SIDE_M = 8.0
#: Arrivals of the law t = K d^P: those of a slab 0.2 m thick at 1 m take 0.8 ms.
K, P = 8e-4, 4 / 3
TOPIC = "/seismic"


def grid(across: int, along: int) -> Array:
    """Sensors in rows, from wall to wall."""
    x, y = np.linspace(0.5, SIDE_M - 0.5, across), np.linspace(0.5, SIDE_M - 0.5, along)
    return np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)


LAYOUTS = {4: grid(2, 2), 6: grid(2, 3), 9: grid(3, 3), 16: grid(4, 4)}


@dataclass
class Walk:
    """Steps in a room: where they were, and when each sensor heard them.

    Attributes
    ----------
    positions, stated
        Where the sensors stand and where the geometry has them, shape (n, 2) [m].
    places
        Shape (m, 2) [m].
    true_s, times_s
        Shape (m, n): arrivals after the step as they are and as they were picked [s].
    """

    positions: Array
    stated: Array
    places: Array
    true_s: Array
    times_s: Array

    @classmethod
    def make(
        cls,
        sensors: int | Array,
        seed: int,
        steps: int = 24,
        noise_s: float = 2e-4,
        exponent: float = P,
        scale: float = K,
    ) -> Walk:
        """Walk about a room; pickers err by a normal law."""
        positions = LAYOUTS[sensors].copy() if isinstance(sensors, int) else sensors.copy()
        rng = np.random.default_rng(seed)
        places = rng.uniform(0.6, SIDE_M - 0.6, (steps, 2))
        apart = np.hypot(*(places[:, None] - positions).transpose(2, 0, 1))
        true = scale * apart**exponent
        times = true + rng.normal(0, noise_s, true.shape)
        return cls(positions, positions.copy(), places, true, times)

    def account(
        self, stage: str = "", *, truth: bool = True, picks: bool = True, tolerance_m: float = 1.0
    ) -> PlaceAccount:
        """Explain the places; ``truth`` of them, ``picks`` of their arrivals."""
        return PlaceExplainer(self.evidence(truth=truth, picks=picks), tolerance_m, stage).account()

    def evidence(self, *, truth: bool = True, picks: bool = True) -> Evidence:
        """Return what a replay would have stored."""
        names = tuple(f"G{i + 1}" for i in range(len(self.positions)))
        outline = ((0.0, 0.0), (SIDE_M, 0.0), (SIDE_M, SIDE_M), (0.0, SIDE_M))
        sensors = tuple(
            Sensor(name, name, float(x), float(y))
            for name, (x, y) in zip(names, self.stated, strict=True)
        )
        geometry = Geometry(
            sensors, outline, medium=Medium(thickness_m=0.2, velocity_mps=850.0), unit="m"
        )
        origin = START_NS + np.arange(1, len(self.places) + 1) * NS_PER_S
        at = origin[:, None] + np.rint(np.nan_to_num(self.times_s) * NS_PER_S).astype(np.int64)
        heard = np.isfinite(self.times_s)
        row, channel = np.nonzero(heard)
        order = np.lexsort((channel, at[row, channel]))
        row, channel = row[order], channel[order]
        steps = np.where(heard, at, np.iinfo(np.int64).max).min(axis=1)[heard.any(axis=1)]
        text = 'name = "planted"\ndescription = "Planted."\napplication = "room"\n'
        uses = ("toa-cv", "coincidence", "so-tdoa", "hyperbolic", "power-law", "self-calibrating")
        text += "".join(
            f'[[stage]]\nname = "{name}"\nuse = "{use}"\n'
            for name, use in zip(("picks", "steps", *uses[2:]), uses, strict=True)
        )
        config = parse_pipeline(text.encode(), "planted.toml")
        parts = [_part(config.stage[0], names, at[row, channel], channel)]
        parts += [_part(s, ("all",), steps, np.zeros(len(steps))) for s in config.stage[1:]]
        labels = (
            [
                Label(int(t), "step", x_m=float(x), y_m=float(y))
                for t, (x, y) in zip(origin, self.places, strict=True)
            ]
            if truth
            else []
        )
        if picks and truth:
            labels += [
                Label(int(t + round(s * NS_PER_S)), "pick", channel=name, author=SIMULATOR)
                for t, times in zip(origin, self.true_s, strict=True)
                for name, s in zip(names, times.tolist(), strict=True)
            ]
        end_ns = int(origin[-1]) + NS_PER_S
        return Evidence(
            "planted.mcap", config, tuple(parts), (), tuple(labels), START_NS, end_ns, geometry
        )


def _part(stage: Any, channels: tuple[str, ...], time_ns: Any, channel: Any) -> StageEvidence:
    """Return candidates that all passed their gates."""
    kind: Any = stage_named(stage.use)
    parameters = build(kind.Parameters, stage.parameters, stage.key)
    gates = gate_specs(kind.gates, parameters)
    spec = StageSpec(
        stage.key, stage.use, TOPIC, channels, tuple(kind.columns), gates, (), emitted(kind)
    )
    count = len(time_ns)
    value = np.ones((count, len(spec.columns)), np.float32)
    margin = np.ones((count, len(gates)), np.float32)
    return StageEvidence(
        spec,
        Candidates(np.asarray(time_ns, np.int64), np.asarray(channel, np.int32), value),
        margin + np.array([g.threshold for g in gates], np.float32),
        margin,
        np.ones(count, bool),
        Frames(np.empty(0, np.int64), np.empty((0, len(channels), 0), np.float32)),
    )


def late_clock(walk: Walk, channel: int, late_s: float) -> None:
    """Let a sensor's clock be wrong."""
    walk.times_s[:, channel] += late_s


def displaced(walk: Walk, channel: int, by_m: tuple[float, float]) -> None:
    """State a sensor elsewhere than it stands."""
    walk.stated[channel] += by_m


def swapped(walk: Walk, one: int, other: int) -> None:
    """Exchange two sensors' cables."""
    walk.stated[[one, other]] = walk.stated[[other, one]]


def off_pick(walk: Walk, row: int, channel: int, late_s: float) -> None:
    """Let one arrival be picked late or early."""
    walk.times_s[row, channel] += late_s


def off_together(walk: Walk, rows: list[int], seed: int) -> None:
    """Let every arrival of some steps be picked at a later phase of its own, 3 to 12 ms late."""
    rng = np.random.default_rng(seed)
    walk.times_s[rows] += rng.uniform(3e-3, 12e-3, walk.times_s[rows].shape)


def unheard(walk: Walk, row: int, left: int, seed: int) -> None:
    """Leave so many arrivals of a step."""
    rng = np.random.default_rng(seed)
    gone = rng.permutation(walk.times_s.shape[1])[left:]
    walk.times_s[row, gone] = np.nan
