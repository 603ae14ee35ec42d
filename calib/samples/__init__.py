"""Measured samples: poses and commands, under which conditions, from which recordings."""
