"""The Python API of calib, a function per verb: what commands and notebooks call."""
