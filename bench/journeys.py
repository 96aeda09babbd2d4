"""The three journeys of CONTRIBUTING.md as they are run: which files and functions they enter.

    python bench/journeys.py             figures
    python bench/journeys.py --list      also each function, in the order of entering

A journey is traced, not told. **A block becomes a candidate**: from the end of one block to the
first decision in the next, in a replay of the bundled room. **A decision becomes a remedy**: from
the matching of steps to the first remedy that ``why`` finds in the bundled walk. **An event reaches
Rerun**: from a fix that is
given to the viewer to its rows on the timeline. Only what is ours counts.

Each is held against what CONTRIBUTING.md tells of it: the files that are told and entered, those
told that lie before the trace begins or after it ends, and those entered besides.
"""

from __future__ import annotations

import argparse
import re
import sys
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import timing

import groundtrace as gt
from groundtrace.api.replay import replay_to_files
from groundtrace_codecs.events import Fix
from groundtrace_recordings import path_of

if TYPE_CHECKING:
    from types import CodeType, FrameType

ROOT = Path(__file__).parents[1]


Moment = Callable[[str, bool, Any], bool]


class Function(NamedTuple):
    """A function of ours that a journey enters."""

    file: str
    name: str


class Trace:
    """Notes the functions that are entered between two moments.

    Parameters
    ----------
    begins, ends
        Whether a journey begins or ends here, asked with the name of a function, whether it is
        left, and what it returns or, where it is entered, its arguments; of several that begin
        before one ends the last counts.
    """

    def __init__(self, begins: Moment, ends: Moment) -> None:
        self._begins, self._ends = begins, ends
        self._functions: dict[CodeType, Function | None] = {}
        self._noting = False
        self.entered: dict[Function, None] = {}
        self.done = False

    def __call__(self, frame: FrameType, event: str, value: Any) -> None:
        """Take a call or a return, as :func:`sys.setprofile` tells it."""
        if self.done or event not in ("call", "return"):
            return
        function = self._of(frame.f_code)
        if function is None:
            return
        left = event == "return"
        given = value if left else frame.f_locals
        if self._begins(function.name, left, given):
            self._noting, self.entered = True, {}
        if self._noting:
            self.entered.setdefault(function)
            self.done = self._ends(function.name, left, given)

    def _of(self, code: CodeType) -> Function | None:
        if code not in self._functions:
            path = Path(code.co_filename)
            ours = path.is_relative_to(ROOT) and path.parts[len(ROOT.parts)] in {
                "codecs",
                "replay",
                "viewers",
            }
            # a property or a comprehension is no step of its own
            hidden = not ours or code.co_name.startswith("<")
            name = str(path.relative_to(ROOT)) if ours else ""
            self._functions[code] = None if hidden else Function(name, code.co_qualname)
        return self._functions[code]


def traced(trace: Trace, run: Callable[[], object]) -> dict[Function, None]:
    """Run something and return the functions of its journey."""
    threading.setprofile(trace)
    sys.setprofile(trace)
    try:
        run()
    finally:
        sys.setprofile(None)
        threading.setprofile(None)
    if not trace.done:
        raise RuntimeError("the journey did not end: its first or last function has another name")
    return trace.entered


def block_to_candidate() -> dict[Function, None]:
    """Trace a block of the bundled room on its way to a decision."""
    trace = Trace(
        lambda name, left, _: left and name == "ReplayLoop._finish",
        lambda name, left, given: left and name == "decide" and given[0].accepted.any(),
    )
    return traced(trace, lambda: gt.replay("room-walk", "room-footsteps", to_s=3))


def decision_to_remedy() -> dict[Function, None]:
    """Trace a missed step of the bundled walk on its way to the change that mends it."""
    results = gt.replay("waist-walk", "waist-swing", {"steps.swing": 1.5})
    trace = Trace(
        lambda name, left, _: not left and name == "explain_steps",
        lambda name, left, given: left and name == "RemedySearch.recover" and bool(given),
    )
    return traced(trace, results.why)


def event_to_timeline() -> dict[Function, None]:
    """Trace a fix of the bundled room: taken by its view, and drawn when that is flushed."""
    taken = Trace(
        lambda name, left, given: (
            not left and name == "RerunSink.write" and isinstance(given["item"], Fix)
        ),
        lambda name, left, _: left and name == "FixView.fix",
    )
    drawn = Trace(
        lambda name, left, _: not left and name == "FixView._send",
        lambda name, left, _: left and name == "Timeline.send",
    )
    return traced(taken, _replay_to_file) | traced(drawn, _replay_to_file)


def _replay_to_file() -> None:
    room = path_of("room-walk.mcap")
    with tempfile.TemporaryDirectory() as folder:
        out, rrd = Path(folder) / "room.mcap", Path(folder) / "room.rrd"
        replay_to_files(room, "room-footsteps", out, rrd, to_s=3)


def named_files(journey: str, entered: set[str]) -> set[str]:
    """Return the files that CONTRIBUTING.md names in the paragraph that tells a journey.

    Parameters
    ----------
    journey
        What the paragraph begins with.
    entered
        The files that the trace went through: of several that end alike, these are meant.
    """
    text = (ROOT / "CONTRIBUTING.md").read_text("utf-8")
    paragraph = text.partition(f"**{journey[0].upper()}{journey[1:]}")[2].partition("\n\n")[0]
    ours = [
        str(path.relative_to(ROOT))
        for package in ("codecs", "replay", "viewers")
        for path in (ROOT / package).rglob("*.py")
    ]
    files = set()
    for name in re.findall(r"([\w/]+\.py)`", paragraph):
        fitting = {file for file in ours if file.endswith(f"/{name}")}
        if not fitting:
            raise RuntimeError(f"CONTRIBUTING.md: {journey}: expected a file of ours, found {name}")
        files |= fitting & entered or fitting
    return files


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--list", action="store_true")
    options = parser.parse_args()
    timing.on_one_core()
    for words, journey in (
        ("a block becomes a candidate", block_to_candidate),
        ("a decision becomes a reason and a remedy", decision_to_remedy),
        ("an event reaches Rerun", event_to_timeline),
    ):
        entered = journey()
        files = {function.file for function in entered}
        named = named_files(words, files)
        print(f"{words}: {len(files)} files, {len(entered)} functions")
        outside = f", and {len(named - files)} before or after" if named - files else ""
        print(f"   {len(named & files)} files told{outside}; {len(files - named)} entered besides")
        if options.list:
            for function in entered:
                print(f"   {function.file}  {function.name}")


if __name__ == "__main__":
    main()
