"""Simulators: recordings of rooms, walks and roads with known truth."""
