"""Calibration of arms: Hayati's error model, its least squares, corrections, held-out figures, file and page."""
