"""Samples -> a correction over the whole configuration space, and the commands that give wanted poses."""
