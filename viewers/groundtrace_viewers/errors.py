"""Errors of the viewers.

::

    ViewerError           the viewer does not start, does not answer or cannot show a recording
"""

from __future__ import annotations


class ViewerError(Exception):
    """The viewer does not start, does not answer or cannot show a recording."""
