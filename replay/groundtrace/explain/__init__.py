"""Explanation: why a decision was made, and what the smallest change would do."""
