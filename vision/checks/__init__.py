"""Mistakes that show in corners: each is tried on a few frames, and the one that makes them agree is named."""

from vision.checks.mistake_search_by_trial_corrections import find_corner_mistakes

__all__ = ["find_corner_mistakes"]
