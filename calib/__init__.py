"""Poses to a better rig: parameters, corrections, what is promised of them, and what physics was left out."""
