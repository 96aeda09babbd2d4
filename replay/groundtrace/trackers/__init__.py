"""Trackers: fixes of walkers, one a step, become tracks."""
