"""Mistakes that show in an arm's commands and measured poses."""

from calib.mistakes.arm import look

__all__ = ["look"]
