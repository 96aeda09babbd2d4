"""Fleets: many recordings through some pipelines, one table, whatever computes it.

A recording and a pipeline are a task; what comes of it is a part, a file that is whole or not
there; the parts of all tasks, in the order of the recordings, are the tables.
"""

from __future__ import annotations
