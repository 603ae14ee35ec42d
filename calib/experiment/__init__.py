"""The next experiment: what would tell hypotheses that are still alike apart, at what cost, and with what chance."""
