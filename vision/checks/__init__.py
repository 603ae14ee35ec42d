"""Mistakes that show in corners: each is tried on a few frames, and the one that makes them agree is named."""

from vision.checks.corner_mistake_search import find_corner_mistakes

__all__ = ["find_corner_mistakes"]
