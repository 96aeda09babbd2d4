"""Errors of the viewers.

::

    ViewerError           the viewer does not start, does not answer or cannot show a recording
"""

from __future__ import annotations

from groundtrace_codecs.errors import Error


class ViewerError(Error):
    """The viewer does not start, does not answer or cannot show a recording."""
