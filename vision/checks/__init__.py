"""Mistakes that show in corners: each is tried on a few frames, and the one that makes them agree is named."""

from vision.checks.corner_consistency import look

__all__ = ["look"]
