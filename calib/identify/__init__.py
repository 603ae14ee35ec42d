"""Poses -> the parameters of a mechanism by least squares: with cameras, what poses tell, the most informative
poses.
"""
