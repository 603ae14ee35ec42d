"""A platform's corners and closures as a problem of the engine."""
