"""Exports: what was decided, and the signals, in the formats of other tools."""
