"""A machine's geometry, cameras and recordings in the files that other programs read."""
