"""Mistakes that show in an arm's commands and measured poses."""

from calib.checks.arm_angles_and_poses import find_arm_mistakes

__all__ = ["find_arm_mistakes"]
