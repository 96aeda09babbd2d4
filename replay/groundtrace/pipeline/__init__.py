"""Pipelines: source, engine, stages, gates, configuration, results."""
