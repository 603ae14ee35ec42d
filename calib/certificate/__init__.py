"""A certificate: what held-out recordings say of a calibration, stated, and written as JSON, page, PDF and digital
calibration certificate.
"""
