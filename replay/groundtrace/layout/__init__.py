"""Layouts of sensors: what they can do, and their calibration."""
