"""A calibration watched from day to day: small visits, what changed since and how sure that is."""
