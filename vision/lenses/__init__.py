"""Photographs of a printed board -> a lens."""
