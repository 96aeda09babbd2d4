"""Small recordings with their truth, simulated and real, maps for importing, a catalogue of others.

``README.md`` beside this file says where each recording is from and which command made it. The
files are found in a wheel and in an editable install alike.
"""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from groundtrace_codecs.errors import CodecError

__all__ = ["UnknownFileError", "bundled", "licence_text", "map_path", "maps", "path_of"]


class UnknownFileError(CodecError):
    """No bundled recording or map has this name."""


def bundled() -> dict[str, Path]:
    """Return the bundled recordings by file name, e.g. ``room-walk.mcap``."""
    return _listing(folder(), ".mcap")


def maps() -> dict[str, Path]:
    """Return the bundled import maps by file name."""
    return _listing(folder() / "maps", ".toml")


def path_of(name: str) -> Path:
    """Return the path of the bundled recording ``name``.

    Raises
    ------
    UnknownFileError
        Where there is none of this name; lists those there are.
    """
    return _path_of(name, bundled(), "a bundled recording")


def map_path(name: str) -> Path:
    """Return the path of the bundled map ``name``.

    Raises
    ------
    UnknownFileError
        Where there is none of this name; lists those there are.
    """
    return _path_of(name, maps(), "a bundled map")


def licence_text(name: str) -> str:
    """Return the licence of the bundled recording ``name`` of others, in full, with its notices.

    Raises
    ------
    UnknownFileError
        Where there is none of this name.
    """
    text = (folder() / "THIRD_PARTY.md").read_text("utf-8")
    sections = dict(part.split("\n", 1) for part in text.split("\n## ")[1:])
    if name not in sections:
        raise UnknownFileError(f"{name}: expected one of {', '.join(sections)}")
    return sections[name].strip()


def folder() -> Path:
    """Return where recordings, maps and the catalogue lie."""
    return Path(str(files(__name__)))


def _listing(folder: Path, suffix: str) -> dict[str, Path]:
    if not folder.is_dir():
        return {}
    return {path.name: path for path in sorted(folder.iterdir()) if path.suffix == suffix}


def _path_of(name: str, paths: dict[str, Path], what: str) -> Path:
    if name not in paths:
        raise UnknownFileError(f"{name}: expected {what} ({', '.join(paths) or 'none'})")
    return paths[name]
