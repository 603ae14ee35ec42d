"""Corners -> one pose, robustly; and whose marker is it."""
