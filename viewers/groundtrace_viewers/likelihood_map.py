"""The likelihood of a vehicle's place on the map: an image in each cycle, lighter is likelier."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from .palette import heat
from .sensor_map import SITE
from .timeline import Entity

if TYPE_CHECKING:
    import rerun as rr

    from groundtrace_codecs.traffic import LikelihoodSurface

    from .timeline import Timeline

LIKELIHOOD = f"{SITE}/likelihood"
#: What is less likely than the likeliest by more than this, in log-likelihood, is clear: a place
#: there is ten thousand times less likely. The rest has so many levels.
DEPTH, SHOWN_LEVELS = 9.0, 24
#: Opacity of the likeliest.
OPACITY = 0.8
#: An image goes out after this, unless another comes before [ns].
HOLD_NS = 2 * NS_PER_S


class LikelihoodLog:
    """Logs the images of all stages that locate by likelihood.

    Parameters
    ----------
    timeline
        Where to.
    """

    def __init__(self, timeline: Timeline) -> None:
        self._timeline = timeline
        self._pending: dict[str, list[LikelihoodSurface]] = {}
        self._begun: set[str] = set()
        self._last_ns: dict[str, int] = {}

    def add(self, surface: LikelihoodSurface) -> None:
        """Take the surface of a cycle; those of a stage have one lattice."""
        if surface.stage not in self._begun:
            self._begun.add(surface.stage)
            self._begin(surface)
        self._pending.setdefault(surface.stage, []).append(surface)

    def _begin(self, surface: LikelihoodSurface) -> None:
        import rerun as rr

        path = f"{LIKELIHOOD}/{surface.stage}"
        half = surface.step_m / 2  # nodes are the middles of pixels
        place = rr.Transform3D(
            translation=(surface.x_m - half, surface.y_m - half, 0.0), scale=surface.step_m
        )
        order = rr.SegmentationImage.from_fields(draw_order=-30.0)
        self._timeline.declare(Entity(path, "map"), place, _shades(), order)

    def flush(self) -> None:
        """Log what is pending."""
        import rerun as rr

        for stage, surfaces in self._pending.items():
            path = f"{LIKELIHOOD}/{stage}"
            self._go_out(path, stage, [s.time_ns for s in surfaces])
            columns = rr.SegmentationImage.columns(
                buffer=[_image(s) for s in surfaces],
                format=[_format(s) for s in surfaces],
                opacity=np.ones(len(surfaces), np.float32),
            )
            self._timeline.send(path, [s.time_ns for s in surfaces], columns)
        self._pending = {}

    def close(self) -> None:
        """Log what is pending, and that the last images go out."""
        self.flush()
        for stage, last_ns in self._last_ns.items():
            self._clear(f"{LIKELIHOOD}/{stage}", [last_ns + HOLD_NS])

    def _go_out(self, path: str, stage: str, times_ns: list[int]) -> None:
        """Log that images go out that no other follows in time."""
        before = [self._last_ns.get(stage, times_ns[0]), *times_ns]
        late = np.flatnonzero(np.diff(before) > HOLD_NS)
        if len(late):
            self._clear(path, [before[i] + HOLD_NS for i in late])
        self._last_ns[stage] = times_ns[-1]

    def _clear(self, path: str, times_ns: list[int]) -> None:
        import rerun as rr

        clear = rr.SegmentationImage.columns(opacity=np.zeros(len(times_ns), np.float32))
        self._timeline.send(path, times_ns, clear)


def _shades() -> rr.AnnotationContext:
    """Return the colours of the levels, clear below and nearly opaque above."""
    import rerun as rr

    level = np.arange(SHOWN_LEVELS) / (SHOWN_LEVELS - 1)
    alpha = np.rint(0xFF * OPACITY * np.minimum(1.6 * level, 1.0)).astype(np.uint32)
    colours = (heat(level) & np.uint32(0xFFFFFF00)) | alpha
    return rr.AnnotationContext(
        [rr.AnnotationInfo(id=i, color=int(colour)) for i, colour in enumerate(colours)]
    )


def _image(surface: LikelihoodSurface) -> bytes:
    """Return the shown level of every node, a byte each."""
    below = surface.highest - surface.values()
    shown = (SHOWN_LEVELS - 1) * np.clip(1.0 - below / DEPTH, 0.0, 1.0)
    return np.rint(shown).astype(np.uint8).tobytes()


def _format(surface: LikelihoodSurface) -> rr.components.ImageFormat:
    import rerun as rr

    return rr.components.ImageFormat(
        width=surface.columns, height=surface.rows, channel_datatype=rr.ChannelDatatype.U8
    )
