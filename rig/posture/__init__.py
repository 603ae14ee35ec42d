"""Postures of redundant arms for feeling and making force: measures, searches in the null space, wrenches, motions."""
