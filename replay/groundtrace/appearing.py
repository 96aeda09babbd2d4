"""Outputs that appear whole, under their name, or not at all."""

from __future__ import annotations

import secrets
import shutil
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


@contextmanager
def appearing(path: Path) -> Iterator[Path]:
    """Give a place beside ``path``; the file or folder written there then takes its name.

    What had the name before is there until then, and stays where an exception ends the block.
    """
    mark = secrets.token_hex(4)
    fresh, old = (path.with_name(f".{path.stem}.{mark}.{what}{path.suffix}") for what in "no")
    try:
        yield fresh
        if path.is_dir():  # a folder that is not empty cannot be renamed over
            path.rename(old)
        fresh.replace(path)
    except BaseException:
        if old.exists() and not path.exists():
            old.rename(path)
        raise
    finally:
        for left in (fresh, old):
            if left.is_dir():
                shutil.rmtree(left)
            elif left.exists():
                left.unlink()


def write_text(path: Path, text: str) -> None:
    """Write a text in UTF-8 so that it appears whole or not at all."""
    with appearing(path) as fresh:
        fresh.write_text(text, encoding="utf-8")
