"""What a calibration, and a second instrument, is worth: from poses that nothing was fitted to."""
