"""Plots as inline SVG: axes with nice ticks, lines, dots, bars. Colours are classes of the page."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from html import escape
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

LEFT, RIGHT, TOP, BOTTOM = 58, 16, 14, 44


@dataclass(frozen=True, slots=True)
class Axis:
    """An axis: what it shows, with its unit, and from where to where."""

    label: str
    low: float
    high: float

    def ticks(self, about: int = 6) -> list[float]:
        """Return round values within the axis: 1, 2 or 5 times a power of ten apart."""
        rough = (self.high - self.low) / about
        power = 10.0 ** math.floor(math.log10(rough))
        step = next(m * power for m in (1, 2, 5, 10) if m * power >= rough * 0.999)
        first, last = math.ceil(self.low / step - 1e-9), math.floor(self.high / step + 1e-9)
        return [k * step for k in range(first, last + 1)]


def number(value: float) -> str:
    """Return a coordinate or tick as short text."""
    text = f"{value:.2f}".rstrip("0").rstrip(".")
    return "0" if text in ("-0", "") else text


def element(tag: str, style: str, title: str = "", **attributes: float | str) -> str:
    """Return an SVG element of a class; the title shows where the mouse rests."""
    pairs = "".join(
        f' {name}="{number(value) if isinstance(value, int | float) else escape(value)}"'
        for name, value in attributes.items()
    )
    inner = f"<title>{escape(title)}</title>" if title else ""
    return f'<{tag} class="{style}"{pairs}>{inner}</{tag}>'


def text(x: float, y: float, words: str, style: str = "note") -> str:
    """Return text at a place in pixels."""
    return f'<text class="{style}" x="{number(x)}" y="{number(y)}">{escape(words)}</text>'


def span_of(values: NDArray[np.float64], label: str, least: float = 1e-3) -> Axis:
    """Return an axis that holds all finite values with a margin, at least ``least`` long."""
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 1.0)
    margin = max(0.06 * (high - low), (least - (high - low)) / 2)
    return Axis(label, low - margin, high + margin)


@dataclass(slots=True)
class Plot:
    """A plot that grows by its methods and comes out as SVG.

    Attributes
    ----------
    x, y
        The axes.
    width, height
        Of the whole picture [px].
    rows
        Names of values of y in place of its ticks; empty for ticks.
    """

    x: Axis
    y: Axis
    width: int = 560
    height: int = 320
    parts: list[str] = field(default_factory=list)
    rows: dict[float, str] = field(default_factory=dict)

    def named_rows(self, names: dict[float, str]) -> Plot:
        """Name values of the y axis in place of its ticks."""
        self.rows = names
        return self

    def px(self, value: float) -> float:
        """Return the horizontal place of a value [px]."""
        part = (value - self.x.low) / (self.x.high - self.x.low)
        return LEFT + part * (self.width - LEFT - RIGHT)

    def py(self, value: float) -> float:
        """Return the vertical place of a value [px]."""
        part = (value - self.y.low) / (self.y.high - self.y.low)
        return self.height - BOTTOM - part * (self.height - TOP - BOTTOM)

    def add(self, tag: str, style: str, title: str = "", **attributes: float | str) -> None:
        """Add an element, as :func:`element` makes it."""
        self.parts.append(element(tag, style, title, **attributes))

    def line(self, points: Iterable[tuple[float, float]], style: str) -> None:
        """Add a line through points; it breaks where one is not finite."""
        pieces: list[list[str]] = [[]]
        for x, y in points:
            if math.isfinite(x) and math.isfinite(y):
                pieces[-1].append(f"{number(self.px(x))},{number(self.py(y))}")
            elif pieces[-1]:
                pieces.append([])
        for piece in pieces:
            if len(piece) > 1:
                self.add("polyline", f"line {style}", points=" ".join(piece))

    def dot(self, x: float, y: float, style: str, title: str = "", radius: float = 3.2) -> None:
        """Add a dot."""
        self.add("circle", style, title, cx=self.px(x), cy=self.py(y), r=radius)

    def box(
        self, x: tuple[float, float], y: tuple[float, float], style: str, title: str = ""
    ) -> None:
        """Add a filled rectangle."""
        left, right = self.px(x[0]), self.px(x[1])
        low, high = self.py(y[0]), self.py(y[1])
        self.add("rect", style, title, x=left, y=high, width=right - left, height=low - high)

    def vertical(self, x: float, style: str, title: str = "") -> None:
        """Add a line over the whole height."""
        at = self.px(x)
        self.add("line", style, title, x1=at, x2=at, y1=self.py(self.y.low), y2=TOP)

    def horizontal(self, y: float, style: str) -> None:
        """Add a line over the whole width."""
        at = self.py(y)
        self.add("line", style, x1=LEFT, x2=self.width - RIGHT, y1=at, y2=at)

    def text(self, x: float, y: float, words: str, style: str = "note") -> None:
        """Add text at a place in pixels."""
        self.parts.append(text(x, y, words, style))

    def svg(self, title: str) -> str:
        """Return the picture; ``title`` is read to those who cannot see it."""
        return picture(self.width, self.height, title, [*self._axes(), *self.parts])

    def _axes(self) -> list[str]:
        frame = Plot(self.x, self.y, self.width, self.height)
        floor, middle = self.height - BOTTOM, (self.height - TOP - BOTTOM) / 2 + TOP
        for value in self.x.ticks(max(2, self.width // 90)):
            frame.vertical(value, "grid")
            frame.text(self.px(value), floor + 17, number(value), "tick mid")
        named = self.rows or {v: number(v) for v in self.y.ticks(max(2, self.height // 60))}
        for value, name in named.items():
            frame.horizontal(value, "grid")
            frame.text(LEFT - 7, self.py(value) + 4, name, "tick end")
        frame.text((LEFT + self.width - RIGHT) / 2, self.height - 6, self.x.label, "label mid")
        frame.parts.append(
            f'<text class="label mid" transform="translate(14 {number(middle)}) rotate(-90)">'
            f"{escape(self.y.label)}</text>"
        )
        return frame.parts


def picture(width: int, height: int, title: str, parts: Sequence[str]) -> str:
    """Return an SVG element that fits the width of its place."""
    return (
        f'<svg viewBox="0 0 {width} {height}" role="img" aria-label="{escape(title)}">'
        f"{''.join(parts)}</svg>"
    )
