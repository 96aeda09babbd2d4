"""Comparisons: what several localizers say of the same step."""
