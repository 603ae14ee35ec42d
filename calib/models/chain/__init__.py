"""What only chains of mechanisms have: parameters stage by stage, calibrated together, and what cannot be told apart
among them.
"""
