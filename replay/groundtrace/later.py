"""Modules that are imported when something of them is first asked for.

Compiled functions take half a second to import. Commands that only list or explain pipelines do not
need them, and the code that runs them asks for them so often that an ``import`` in the function
would count.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any


class Later:
    """Stands for a module until something of it is asked for, and then for what was asked for.

    Parameters
    ----------
    name
        Of the module, in full.
    """

    def __init__(self, name: str) -> None:
        self._module_name = name

    def __getattr__(self, name: str) -> Any:
        """Return what the module has under a name, which is found here from then on."""
        found = getattr(import_module(self._module_name), name)
        setattr(self, name, found)
        return found
