"""Pages of jinja2 templates: HTML that needs no other file and no network."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..visible import visible
from .drawing import COLOURS

if TYPE_CHECKING:
    from jinja2 import Environment

#: Templates that all pages share.
SHARED = Path(__file__).parent


def shown(value: float | None, unit: str, digits: int = 2, *, sign: bool = False) -> str:
    """Return a number with its unit, or a dash."""
    if value is None:
        return "\N{EN DASH}"
    return f"{value:{'+' if sign else ''}.{digits}f} {unit}"


def _harmless(value: Any) -> Any:
    """Return a text as it may be shown; what is markup already is not that of others."""
    return visible(value) if type(value) is str else value


@cache
def _environment(folder: Path) -> Environment:
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader([folder, SHARED]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=_harmless,
    )
    environment.filters |= {"shown": shown, "fixed": lambda value, digits: f"{value:.{digits}f}"}
    environment.globals |= {"colours": COLOURS}
    return environment


def rendered(template: str, folder: Path = SHARED, **values: Any) -> str:
    """Return a template filled in; all text in it is escaped.

    Parameters
    ----------
    template
        Its file name.
    folder
        Where it is; those of this folder can be used by it.
    values
        What it names.
    """
    return _environment(folder).get_template(template).render(values)
