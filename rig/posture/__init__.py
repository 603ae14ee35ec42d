"""Postures of redundant arms to sense and exert force: measures, searches in the null space, wrenches, motions."""
