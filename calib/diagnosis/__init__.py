"""Unmodelled effects: where, which, how large, confirmed on held-out stretches."""
