"""Exports: decisions and signals in the formats of other tools."""
