"""Calibration of platforms on struts: parameters, their observability, the configurations that determine them."""
