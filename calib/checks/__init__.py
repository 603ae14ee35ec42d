"""Mistakes that show in an arm's commands and measured poses."""

from calib.checks.arm_angles_and_poses import look

__all__ = ["look"]
