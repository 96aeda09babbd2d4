"""Make the bundled excerpts of real recordings again, from the files they were cut out of.

    python bench/excerpts.py recordings/groundtrace_recordings     all of them, into that folder

Each ``NAME.toml`` beside the bundled recordings says which files of ``GROUNDTRACE_DATA`` an excerpt
is of, by their SHA-256, and the commands that make it. Title, address, licence, authors and changes
become a metadata record of the excerpt, which copies keep and ``groundtrace info`` prints.
"""

from __future__ import annotations

import contextlib
import os
import shlex
import shutil
import sys
import tempfile
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import groundtrace_recordings
from groundtrace.api.inspection import SOURCE
from groundtrace.cli.main import main as groundtrace
from groundtrace.pipeline.results import file_sha256
from groundtrace_codecs.copies import atomic_write, copy_frame, send_all
from groundtrace_codecs.mcap.reader import McapFile
from groundtrace_codecs.mcap.writer import Container

if TYPE_CHECKING:
    from collections.abc import Iterator

#: What of a description travels inside the excerpt.
TOLD = ("title", "url", "licence", "authors", "citation", "changed")


def descriptions() -> dict[str, dict[str, Any]]:
    """Return the description of each excerpt by its name."""
    folder = Path(groundtrace_recordings.__file__).parent
    every = {p.stem: tomllib.loads(p.read_text("utf-8")) for p in sorted(folder.glob("*.toml"))}
    return {name: each for name, each in every.items() if "sources" in each}


def make(name: str, described: dict[str, Any], data: Path, folder: Path) -> Path:
    """Make an excerpt, and return its file.

    Parameters
    ----------
    name, described
        Of :func:`descriptions`.
    data
        Folder of the recordings of others.
    folder
        Where the excerpt goes.
    """
    sources = {data / file: sha256 for file, sha256 in described["sources"].items()}
    for source, sha256 in sources.items():
        if (actual_sha256 := file_sha256(source)) != sha256:
            raise SystemExit(f"{source}: expected SHA-256 {sha256}, found {actual_sha256}")
    target = folder.resolve() / f"{name}.mcap"
    with tempfile.TemporaryDirectory() as made, inside(Path(made)):
        for source in sources:
            shutil.copy(source, source.name)
        for command in described["commands"]:
            groundtrace(shlex.split(command)[1:])
        tell(Path(target.name), target, {key: described[key] for key in TOLD})
    return target


def tell(excerpt: Path, target: Path, record: dict[str, str]) -> None:
    """Copy an excerpt, message by message, and add where it is from."""
    file = McapFile.open(excerpt)
    container = Container(target, "zstd", force=True, profile=file.profile)
    with contextlib.closing(file), atomic_write(container):
        ids = copy_frame(file, container, file.channels.keys())
        container.add_metadata(SOURCE, record)
        send_all(file, container, ids, file.as_recorded())


@contextlib.contextmanager
def inside(folder: Path) -> Iterator[None]:
    """Work in a folder."""
    before = Path.cwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)


def main() -> None:
    """Make all excerpts into the folder that is given."""
    data = Path(os.environ["GROUNDTRACE_DATA"])
    for name, described in descriptions().items():
        path = make(name, described, data, Path(sys.argv[1]))
        print(f"{path}: {path.stat().st_size} bytes")


if __name__ == "__main__":
    main()
