"""Experiments: chances that hold, plans that can be run."""
