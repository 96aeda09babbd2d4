"""Detectors: picks, steps and faults of signals."""
