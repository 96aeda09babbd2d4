"""Where worn sensors are guessed to be, as a confusion table: the table of placement.md.

    python bench/placement_guess.py --data FOLDER [--each]

The folder holds ``mobgap``, ``oxford-step``, ``llio-pyshoe``, ``xio-gait``, ``indoor-location-20``
and ``broad`` as published; what is absent is left out. ``looked at`` are the recordings that were
at hand when measures and thresholds were chosen, ``kept back`` the others.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from collections import Counter, defaultdict
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, get_args

from step_accuracy import PHONE

from groundtrace.inertial.placement import PlacementWatch, Site
from groundtrace.pipeline.source import Source
from groundtrace_codecs.importers.run import import_recording
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import SignalBlock
from groundtrace_recordings import map_path

if TYPE_CHECKING:
    from collections.abc import Iterator

    from groundtrace.inertial.placement import PlacementGuess

#: Parts of the paths of the recordings looked at.
LOOKED_AT = (
    "mobgap/HA",
    "user1_hand",
    "user1_frontpocket",
    "user1_bag",
    "Pixel_Jamie",
    "Samsung_Dario",
    "2017-11-2",
    *(f"indoor-location-20/site1/{floor}" for floor in ("B1", "F1", "F4")),
    "5dda5247c5b77e0006b176fb",
)
#: What is no walking: sensors turned and swung by hand in front of cameras.
HANDLED = "not walking"


class Case(NamedTuple):
    """A recording, where it was worn, and how it is read."""

    worn: str
    path: Path
    columns: Path | None


def cases(folder: Path, phone: Path) -> Iterator[Case]:
    """Yield the recordings that are there."""
    for path in sorted(folder.glob("mobgap/*/*/data.mat")):
        yield Case("lower back", path, map_path("mobgap-test11.toml"))
    for path in sorted(folder.glob("llio-pyshoe/*.mat")):
        yield Case("foot", path, map_path("llio-pyshoe.toml"))
    for path in sorted(folder.glob("xio-gait/*.csv")):
        yield Case("foot", path, map_path("xio-gait.toml"))
    for path in sorted(folder.glob("oxford-step/validation/*.csv")):
        worn = path.stem.split("_")[1]
        worn = "pocket" if worn.endswith("pocket") else worn
        yield Case(worn, path, map_path("oxford-step-validation.toml"))
    for path in sorted(folder.glob("oxford-step/optimisation/*/accelerometer.csv")):
        yield Case("hand" if "InHand" in path.parent.name else "pocket", path, phone)
    for path in sorted(folder.glob("indoor-location-20/*/*/path_data_files/*.txt")):
        yield Case("hand", path, None)
    for kind in ("hdf5", "mat"):
        for path in sorted(folder.glob(f"broad/*.{kind}")):
            yield Case(HANDLED, path, map_path(f"broad-{kind}.toml"))


def guess_of(case: Case) -> PlacementGuess | None:
    """Import a recording and guess."""
    with tempfile.TemporaryDirectory() as scratch:
        file = Path(scratch) / "rec.mcap"
        import_recording([case.path], file, map_path=case.columns)
        with Recording.open(file) as opened:
            stream = next(s for s in opened.streams if PlacementWatch.fits(s))
            watch = PlacementWatch(stream)
            for item in Source(opened, topics=[stream.topic]):
                if isinstance(item, SignalBlock):
                    watch.update(item)
                elif not item.bridged:
                    watch.gap()
                if watch.done:
                    break
        return watch.guess()


def table(title: str, counts: dict[str, Counter[str]]) -> None:
    """Print how often each place was guessed, by where the sensor was worn."""
    columns = (*get_args(Site), "no guess")
    print(f"{title:12}" + "".join(f"{name:>9}" for name in columns))
    for worn, guessed in counts.items():
        print(f"{worn:12}" + "".join(f"{guessed[name] or '.':>9}" for name in columns))


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--data", type=Path, default=Path(os.environ.get("GROUNDTRACE_DATA", "../shared/data"))
    )
    parser.add_argument("--each", action="store_true", help="print every guess")
    options = parser.parse_args()
    seen: dict[str, Counter[str]] = defaultdict(Counter)
    held_out: dict[str, Counter[str]] = defaultdict(Counter)
    with tempfile.TemporaryDirectory() as scratch:
        phone = Path(scratch) / "phone.toml"
        phone.write_text(PHONE)
        for case in cases(options.data, phone):
            guess = guess_of(case)
            looked = any(part in case.path.as_posix() for part in LOOKED_AT)
            site = "no guess" if guess is None else guess.site
            (seen if looked else held_out)[case.worn][site] += 1
            if options.each:
                name = "/".join(case.path.parts[-2:])
                print(f"{case.worn:12}{name}: {'no guess' if guess is None else guess.text}")
    table("looked at", seen)
    table("kept back", held_out)


if __name__ == "__main__":
    main()
