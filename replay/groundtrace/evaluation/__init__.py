"""Results against truth, with the level that chance alone would reach."""
