"""Accuracy of a calibration, and of a second instrument, from poses not used for fitting."""
