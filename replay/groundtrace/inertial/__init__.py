"""Worn sensors: attitude, heading, inertial navigation, dead reckoning."""
