"""Choosing an exporter and its kinds, and writing so that the output is there whole or not."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

from ..appearing import appearing
from ..errors import PluginError, RecordingError
from ..plugins import load, plugins
from .kinds import all_kinds, has_step_truth, there

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from .api import Exporter, Material, Written

GROUP = "exporters"


def exporters() -> tuple[dict[str, Exporter], tuple[str, ...]]:
    """Return the installed exporters by name, and why others do not load."""
    found: dict[str, Exporter] = {}
    troubles = []
    for plugin in plugins(GROUP):
        try:
            found[plugin.name] = cast("Exporter", load(GROUP, plugin.name)())
        except PluginError as error:
            troubles.append(str(error))
    return found, tuple(troubles)


def choose(known: dict[str, Exporter], path: Path, name: str | None) -> Exporter:
    """Return the exporter that is named, or else the one that a file's name means.

    A name without a suffix is a folder of CSV tables.

    Raises
    ------
    RecordingError
        Where there is none.
    """
    if name is not None:
        if name not in known:
            raise RecordingError(f"--format: expected one of {', '.join(known)}, found {name!r}")
        return known[name]
    suffix = path.suffix.lower() if not path.is_dir() else ""
    wanted = [e for e in known.values() if (suffix in e.suffixes if suffix else e.name == "csv")]
    if not wanted:
        ends = ", ".join(end for e in known.values() for end in e.suffixes)
        raise RecordingError(
            f"{path}: expected a name that ends in one of {ends}, a folder, or --format, "
            f"found {suffix or 'none'}"
        )
    return wanted[0]


def is_folder(exporter: Exporter, path: Path) -> bool:
    """Whether a path is to be a folder with a file of each kind."""
    return exporter.one_kind and path.suffix.lower() not in exporter.suffixes


def chosen_kinds(
    exporter: Exporter, material: Material, asked: Sequence[str], *, folder: bool
) -> list[str]:
    """Return the kinds to write: those asked for, or all that there is something of.

    Raises
    ------
    RecordingError
        Where one is none of the exporter's, there is nothing, or one file cannot hold several.
    """
    for kind in asked:
        if kind not in exporter.kinds:
            raise RecordingError(
                f"--kind: {exporter.name}: expected one of {', '.join(exporter.kinds)}, "
                f"found {kind!r}"
            )
    if "misses" in asked and not has_step_truth(material):
        raise RecordingError(
            f"{material.name}: misses: expected results with true steps, found none"
        )
    kinds = list(dict.fromkeys(asked))
    if not kinds and exporter.kinds == ("signals",):
        kinds = ["signals"]
    if not kinds:
        have = there(material)
        kinds = [kind for kind in exporter.kinds if kind in have]
        if not kinds:
            others = ", ".join(kind for kind in all_kinds() if kind in have) or "none"
            raise RecordingError(
                f"{material.name}: {exporter.name}: expected something of "
                f"{', '.join(exporter.kinds)}, found {others}"
            )
    if exporter.one_kind and not folder and len(kinds) > 1:
        raise RecordingError(
            f"{material.name}: --kind: expected one of {', '.join(kinds)} for one file, found "
            f"{len(kinds)} kinds; -o FOLDER takes them all"
        )
    return kinds


def export(
    exporter: Exporter,
    material: Material,
    kinds: Sequence[str],
    path: Path,
    *,
    folder: bool = False,
) -> Written:
    """Write some kinds; the output appears under its name when it is whole.

    A folder that exists is replaced only where it holds nothing but such tables.

    Raises
    ------
    GroundtraceError, CodecError
        Where the material lacks something, a package is missing, or the folder holds other files.
    """
    if folder and path.is_dir():
        others = [p.name for p in path.iterdir() if p.suffix not in exporter.suffixes]
        if others:
            raise RecordingError(
                f"{path}: expected a folder of {exporter.name} tables to replace, "
                f"found {sorted(others)[0]} in it: it stays"
            )
    with appearing(path) as fresh:
        if folder:
            fresh.mkdir()
        return exporter.write(material, kinds, fresh)
