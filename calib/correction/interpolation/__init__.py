"""Ways to extend corrections from visited configurations over the whole configuration space."""
