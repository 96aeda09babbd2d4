"""Fleets: many recordings through some pipelines, one table, whatever computes it."""
