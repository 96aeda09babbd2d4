"""A replay on a Rerun timeline: the only code that knows Rerun."""
