"""Rubbish into every reader of outside data: whatever it is, a RigError within a second and a gibibyte, or it is
read.
"""
