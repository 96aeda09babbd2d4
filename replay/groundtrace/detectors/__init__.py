"""Detectors, each split into ``process`` (signal to candidates) and gates (see gates.decide)."""
