"""Localizers: where an impact was, from the arrivals at sensors of known places."""
