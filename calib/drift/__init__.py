"""A calibration monitored from day to day: small visits, what changed since and how certain that is."""
