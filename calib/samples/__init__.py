"""Measured samples: poses beside commands, under which conditions, from which recordings."""
