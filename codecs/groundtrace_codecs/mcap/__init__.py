"""MCAP recordings: reading them whatever their state, damage accounted for."""
