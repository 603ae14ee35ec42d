"""Corners -> one pose, robustly."""
