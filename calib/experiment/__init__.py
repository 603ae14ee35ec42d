"""The next experiment: what distinguishes the remaining hypotheses, at what cost, and with what chance."""
