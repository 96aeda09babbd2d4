"""What is found, as one JSON document: what ``--json`` prints and the API returns."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import msgspec

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..warned import Warned


def plain_document(document: Any, warnings: Sequence[Warned] | None = None) -> Any:
    """Return an object as dicts, lists, texts and numbers; a number that is not finite is None.

    Parameters
    ----------
    document
        An object, or a dict of such.
    warnings
        What a replay warned of: becomes its property ``warnings``, unless None.
    """
    plain = _finite(msgspec.to_builtins(document, enc_hook=str))
    if warnings is not None:
        plain["warnings"] = [warned.document for warned in warnings]
    return plain


def _finite(value: Any) -> Any:
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return value
