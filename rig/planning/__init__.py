"""Which configurations to visit, in what order, and rigs laid out from a few figures."""
