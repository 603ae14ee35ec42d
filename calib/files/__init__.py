"""calibration.json and what it holds, read and written."""
