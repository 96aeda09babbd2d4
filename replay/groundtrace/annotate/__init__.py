"""Annotations by people: kept beside a recording, usable as truth."""
