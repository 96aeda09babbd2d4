"""Paths into nested archives: ``data.Trial1.SU.LowerBack.Acc[:,0]``, ``bouts[*].Start``.

A path is names joined by dots, each followed by any number of brackets: ``[*]`` takes each
element of a struct array, ``[3]`` one element, ``[:,0]`` one column of a matrix.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..errors import SchemaError

_STEP = re.compile(r"(?:^|\.)([A-Za-z_]\w*)|\[([^\[\]]*)\]")


def evaluate(root: Any, path: str, place: str) -> list[Any]:
    """Return what ``path`` leads to, one entry for each element of its ``[*]``.

    Parameters
    ----------
    root
        Nested mappings and arrays.
    path
        As the module describes.
    place
        Start of error messages.

    Raises
    ------
    SchemaError
        Where the path is no path or leads nowhere; names the step that failed.
    """
    found: list[Any] = [root]
    position = 0
    while position < len(path):
        step = _STEP.match(path, position)
        if step is None:
            raise SchemaError(
                f"{place}: {path}: expected a name or [index] at {path[position:]!r}, found neither"
            )
        taken = f"{place}: {path[: step.end()]}"
        if step[1] is not None:
            found = [_member(value, step[1], taken) for value in found]
        elif step[2] == "*":
            found = [element for value in found for element in np.atleast_1d(value)]
        else:
            found = [_indexed(value, step[2], taken) for value in found]
        position = step.end()
    return found


def column(root: Any, path: str, place: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return the numbers ``path`` leads to as one column, shape (n,), float64.

    Raises
    ------
    SchemaError
        Where the path leads to something else than one vector of numbers.
    """
    found = evaluate(root, path, place)
    try:
        values = np.squeeze(np.asarray(found[0] if len(found) == 1 else found))
        if values.ndim > 1 or np.iscomplexobj(values):
            raise SchemaError(
                f"{place}: {path}: expected one column of numbers, found shape {values.shape}"
            )
        return np.atleast_1d(values).astype(np.float64)
    except (ValueError, TypeError) as error:
        raise SchemaError(f"{place}: {path}: expected numbers, found: {error}") from error


def _member(value: Any, name: str, place: str) -> Any:
    """Return a field of a mapping or struct."""
    fields = value if isinstance(value, Mapping) else {}
    if name not in fields:
        names = sorted(n for n in fields if not n.startswith("_"))
        raise SchemaError(f"{place}: expected one of {', '.join(names) or 'no names'}, found none")
    return fields[name]


def _indexed(value: Any, text: str, place: str) -> Any:
    """Return an element or column of an array; the text holds integers and ``:``."""
    parts = [p.strip() for p in text.split(",")]
    if not all(p == ":" or re.fullmatch(r"-?\d+", p) for p in parts):
        raise SchemaError(f"{place}: expected [*], [i] or [:,j], found [{text}]")
    index = tuple(slice(None) if p == ":" else int(p) for p in parts)
    try:
        return np.atleast_1d(value)[index]
    except IndexError as error:
        raise SchemaError(f"{place}: expected an index inside the array, found: {error}") from error
