"""Figures in one style, drawn by matplotlib, as SVG that stands in a page or alone.

The colours are names of the page's style sheet (``page.css``), so that a figure in a page is light
or dark as the page is. They follow Okabe and Ito (2008), told apart by colour-blind people.
"""

from __future__ import annotations

import re
from contextlib import contextmanager
from io import StringIO
from typing import TYPE_CHECKING, Any
from warnings import catch_warnings, filterwarnings
from xml.etree import ElementTree

import numpy as np
from markupsafe import Markup

from ..runtime import unconfigured
from ..visible import visible

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from matplotlib.artist import Artist
    from matplotlib.container import BarContainer
    from numpy.typing import ArrayLike

#: The light ones; ``page.css`` has those on dark.
COLOURS = {
    "paper": "#ffffff",
    "ink": "#1b2028",
    "soft": "#5c6673",
    "rule": "#dfe3e8",
    "scored": "#e9f1f7",
    "result": "#0072b2",
    "hit": "#00916a",
    "missed": "#d1480f",
    "false": "#b8377f",
    "chance": "#8a94a0",
    "random": "#b9802f",
}
#: Sizes of figures [px]: half a page and a whole one; text of 12 px is read on a telephone too.
WIDTH, HEIGHT, WIDE = 480, 290, 980
FONT_PX = 12
_STYLE: Any = {
    "svg.fonttype": "none",  # text stays text
    "text.parse_math": False,  # names may have dollars
    "font.size": FONT_PX,
    "figure.facecolor": COLOURS["paper"],  # whatever the user's style: ink is for this paper
    "axes.facecolor": COLOURS["paper"],
    "legend.labelcolor": COLOURS["ink"],
    "text.color": COLOURS["ink"],
    "axes.labelcolor": COLOURS["ink"],
    "axes.edgecolor": COLOURS["soft"],
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.formatter.useoffset": False,
    "figure.titlesize": 13,
    "axes.titlesize": 13,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "grid.color": COLOURS["rule"],
    "xtick.color": COLOURS["soft"],
    "ytick.color": COLOURS["soft"],
}
_SVG, _XLINK = "{http://www.w3.org/2000/svg}", "{http://www.w3.org/1999/xlink}"
_FRACTION = re.compile(r"-?\d+\.\d+")
_UNWRITABLE = re.compile("[^\t\n\r -\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
#: What the page's style sheet says for all, or of what nothing is left here.
_LEFT_OUT = ("font-family", "stroke-dashoffset", "stroke-linejoin", "stroke-linecap")


@contextmanager
def style(**more: Any) -> Iterator[None]:
    """Let matplotlib draw in this style inside a ``with``, and as before after it."""
    with unconfigured():
        from matplotlib import rc_context

    with rc_context(_STYLE | more):
        yield


class Drawing:
    """A figure that grows by its methods and comes out as SVG.

    Parameters
    ----------
    title
        Read to those who cannot see it.
    x, y
        Labels of the axes, with units.
    width, height
        Of the whole figure [px].
    panels
        So many axes side by side; the methods draw on :attr:`axes`, at first the left one.
    """

    def __init__(
        self,
        title: str,
        x: str = "",
        y: str = "",
        width: float = WIDTH,
        height: float = HEIGHT,
        panels: int = 1,
    ) -> None:
        self.title = title
        self._tips: dict[str, Sequence[str]] = {}
        with style():
            from matplotlib.figure import Figure

            self.figure = Figure((width / 72, height / 72), layout="constrained")
            self.figure.patch.set_visible(False)
            self.panels = [self.figure.add_subplot(1, panels, i + 1) for i in range(panels)]
        for axes in self.panels:
            axes.patch.set_visible(False)
            axes.tick_params(length=0, pad=5)
        self.axes = self.panels[0]
        self.axes.set(xlabel=x, ylabel=y)

    def dots(
        self,
        x: ArrayLike,
        y: ArrayLike,
        colour: str,
        tips: Sequence[str] = (),
        size: float = 5,
        **more: Any,
    ) -> None:
        """Add marks, and words that show where the mouse rests; what is not finite is left out.

        Parameters
        ----------
        x, y
            Shape (n,).
        colour
            One of :data:`COLOURS`.
        tips
            One for each mark, or none.
        size
            Diameter [px].
        more
            More of matplotlib's properties of lines, ``marker`` for one.
        """
        across, up = (np.asarray(each, np.float64).ravel() for each in (x, y))
        seen = np.isfinite(across) & np.isfinite(up)
        if not seen.any():
            return
        look: dict[str, Any] = {
            "marker": "o",
            "markeredgewidth": 0,
            "color": COLOURS[colour],
        } | more
        (drawn,) = self.axes.plot(across[seen], up[seen], linestyle="", markersize=size, **look)
        self.tell(drawn, [tip for tip, is_finite in zip(tips, seen, strict=False) if is_finite])

    def line(self, x: ArrayLike, y: ArrayLike, colour: str, dashes: str = "-", **more: Any) -> None:
        """Add a line through points; it breaks where one is not finite."""
        look: dict[str, Any] = {"color": COLOURS[colour], "linewidth": 1.8} | more
        self.axes.plot(x, y, dashes, **look)

    def bars(self, edges: ArrayLike, counts: ArrayLike, tips: Sequence[str]) -> None:
        """Add a histogram: edges of shape (n + 1,), counts and words of shape (n,)."""
        ends, heights = np.asarray(edges, np.float64), np.asarray(counts, np.float64)
        bars = self.axes.bar(
            ends[:-1], heights, np.diff(ends), align="edge", color=COLOURS["result"],
            edgecolor=COLOURS["paper"], linewidth=0.8,
        )  # fmt: skip
        self.tell_bars(bars, tips)

    def mark(self, x: float | None = None, y: float | None = None, colour: str = "ink") -> None:
        """Add a broken line over the whole height at ``x``, or over the whole width at ``y``."""
        broken: dict[str, Any] = {
            "color": COLOURS[colour],
            "linewidth": 1,
            "linestyle": (0, (5, 4)),
        }
        if x is not None:
            self.axes.axvline(x, **broken)
        if y is not None:
            self.axes.axhline(y, **broken)

    def note(self, x: float, y: float, words: str, **more: Any) -> None:
        """Add words a little to the right of a place."""
        look: dict[str, Any] = {"xytext": (4, 2), "textcoords": "offset points"} | more
        self.axes.annotate(words, (x, y), color=COLOURS["ink"], fontsize=FONT_PX, **look)

    def tell(self, artist: Artist, tips: Sequence[str]) -> None:
        """Give an artist's marks, in their order, words that show where the mouse rests."""
        if tips:
            artist.set_gid(f"tips-{len(self._tips)}")
            self._tips[f"tips-{len(self._tips)}"] = tips

    def tell_bars(self, bars: BarContainer, tips: Sequence[str]) -> None:
        """Give each bar words that show where the mouse rests."""
        for bar, tip in zip(bars.patches, tips, strict=True):
            self.tell(bar, [tip])

    def svg(self, *, alone: bool = False) -> Markup:
        """Return the figure as an SVG element.

        Parameters
        ----------
        alone
            For a file of its own, light on white, instead of for a page, whose colours it takes.
        """
        out = StringIO()
        with style(**{"svg.hashsalt": self.title}), catch_warnings():
            filterwarnings("ignore", "Glyph .* missing from font")  # the reader's has it
            nothing = dict.fromkeys(("Date", "Creator", "Format", "Type"))
            self.figure.savefig(out, format="svg", metadata=nothing)
        root = ElementTree.fromstring(_writable(out.getvalue()))
        for group in root.iter(f"{_SVG}g"):
            _tell(group, self._tips.get(group.attrib.pop("id", ""), ()))
        _tidy(root, alone=alone)
        size = root.get("viewBox", "")
        root.attrib = {"viewBox": size, "role": "img", "aria-label": self.title}
        if alone:
            width, height = size.split()[2:]
            font = {"font-family": "system-ui, sans-serif", "font-size": f"{FONT_PX}px"}
            root.attrib |= {"xmlns": _SVG[1:-1], "width": width, "height": height} | font
            paper = {"width": "100%", "height": "100%", "fill": COLOURS["paper"]}
            root.insert(0, ElementTree.Element("rect", paper))
        return Markup(ElementTree.tostring(root, "unicode"))


def _tell(group: ElementTree.Element, tips: Sequence[str]) -> None:
    """Give the marks of a group their words."""
    if not tips:
        return
    defined = {e for d in group.iter(f"{_SVG}defs") for e in d.iter()}
    drawn = [e for e in group.iter() if e.tag in (f"{_SVG}use", f"{_SVG}path")]
    marks = [e for e in drawn if e not in defined]
    for mark, tip in zip(marks, tips, strict=True):
        if tip:
            words = ElementTree.SubElement(mark, "title")
            words.text = _writable(tip)


def _writable(text: str) -> str:
    """Return a text as XML takes it, and as it may be shown."""
    return _UNWRITABLE.sub("\N{REPLACEMENT CHARACTER}", visible(text))


def _tidy(element: ElementTree.Element, *, alone: bool) -> None:
    """Leave out what says nothing, and say the rest in attributes, which every policy lets pass.

    A rule of a style that stands in an attribute is refused where a page lives inside another.
    """
    element.tag = element.tag.removeprefix(_SVG)
    for child in list(element):
        if child.tag in (f"{_SVG}metadata", f"{_SVG}style", f"{_SVG}clipPath"):
            element.remove(child)
            continue
        _tidy(child, alone=alone)
        if child.tag in ("g", "defs") and not len(child):
            element.remove(child)
        elif child.tag == "g" and not child.attrib:
            index = list(element).index(child)
            element[index : index + 1] = list(child)
    for rule in element.attrib.pop("style", "").split("; "):
        name, _, value = rule.partition(": ")
        if name and name not in _LEFT_OUT and (name, value) != ("font-size", f"{FONT_PX}px"):
            element.set(name, value)
    element.attrib.pop("clip-path", None)
    if f"{_XLINK}href" in element.attrib:
        element.set("href", element.attrib.pop(f"{_XLINK}href"))
    if element.tag not in ("text", "title"):
        element.text = None
    element.tail = None
    if element.tag == "text" and element.get("transform", "").startswith("rotate(-0"):
        del element.attrib["transform"]
    named = {} if alone else {hexed: f"var(--{name})" for name, hexed in COLOURS.items()}
    for name, value in element.attrib.items():
        short = _FRACTION.sub(lambda match: f"{round(float(match[0]), 2):g}", value)
        element.set(name, named.get(short, " ".join(short.split())))
    if len(element) and all(child.tag == "use" for child in element):
        _share(element)


def _share(group: ElementTree.Element) -> None:
    """Say once for a group of marks what all of them have."""
    for name in ("fill", "stroke", "stroke-width"):
        if len(values := {mark.get(name) for mark in group}) == 1 and None not in values:
            group.set(name, values.pop() or "")
            for mark in group:
                del mark.attrib[name]
