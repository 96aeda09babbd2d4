"""Where a recording lies: a path, or a URL whose secrets are used to open it and never printed.

User, password and query of a URL open it, and must not be kept in a table, a report, results, a
shared folder or a log. So a :class:`Location` is made of what came in, at the edge of the program;
whatever is made of it afterwards, a path too, has only the public part of the URL. What opens it is
kept in the memory of this process, and goes along to others where a location is pickled.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, Self
from urllib.parse import urlsplit

from .errors import CodecError

if TYPE_CHECKING:
    from pathlib import Path

_URL = re.compile(r"[a-zA-Z][a-zA-Z0-9+.-]+:/")
_URLS = re.compile(r"[a-zA-Z][a-zA-Z0-9+.-]+://[^\s'\"]+")
_TO_THE_END = re.compile(r"[a-zA-Z][a-zA-Z0-9+.-]+://.*")
#: What opens a URL, by its public part.
_OPENED_BY: dict[str, str] = {}


class Location(str):
    """A path, or the public part of a URL: without user, password, query and fragment.

    Parameters
    ----------
    location
        A path or a URL. What opens the URL is kept; see :meth:`opened_by`.

    Raises
    ------
    CodecError
        Where another URL was given that differs in what is not public alone: the two could not be
        told apart.
    """

    __slots__ = ()

    def __new__(cls, location: str | Path) -> Self:
        """Keep what is secret apart."""
        if not is_url(location):
            return super().__new__(cls, location)
        url = as_url(location)
        public = _public(url)
        if public != url and _OPENED_BY.setdefault(public, url) != url:
            raise CodecError(
                f"{public}: expected URLs that differ before their query, found two that do not"
            )
        return super().__new__(cls, public)

    def __reduce__(self) -> tuple[Any, ...]:
        """Take what opens the URL along."""
        return type(self), (self.opened_by(),)

    def opened_by(self) -> str:
        """Return what opens the location, secrets included: for file systems, never for a text."""
        return _OPENED_BY.get(self, str(self))


def is_url(location: str | Path) -> bool:
    """Tell whether a location is a URL, also after a path made one slash of its two."""
    return _URL.match(str(location)) is not None


def as_url(location: str | Path) -> str:
    """Return the URL that a location is, with both its slashes."""
    scheme, _, rest = str(location).partition(":")
    if rest.startswith("//"):
        return str(location)
    return f"{scheme}://{rest if scheme == 'file' else rest[1:]}"


def without_secrets(text: str) -> str:
    """Return a text with the public part of each URL in the place of it.

    What other packages say of an error may have the URL in it, or a part of one that was kept.
    """
    text = _URLS.sub(lambda match: _public(match[0]), text)
    secrets: set[str] = set()
    for url in _OPENED_BY.values():
        parts = urlsplit(url)
        secrets.update(filter(None, (parts.query, parts.netloc.rpartition("@")[0], parts.password)))
    for secret in sorted(secrets, key=len, reverse=True):  # one may be a part of another
        text = text.replace(secret, "...")
    return text


def public_argument(argument: str) -> str:
    """Return an argument of a command with the :class:`Location` of a URL in the place of it.

    The URL goes on to the argument's end, from where it begins: behind an option's name, or in a
    setting. A text of several words that does not begin with one is somebody's own, and stays.
    """
    if is_url(argument):
        return str(Location(argument))
    if len(argument.split()) > 1:
        return argument
    return _TO_THE_END.sub(lambda match: str(Location(match[0])), argument)


def _public(url: str) -> str:
    parts = urlsplit(url)
    return f"{parts.scheme}://{parts.netloc.rpartition('@')[2]}{parts.path}"
