"""Detectors, each split into ``measure`` (signal to candidates) and gates (see gates.decide)."""
