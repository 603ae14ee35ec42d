"""An arm's poses as a problem of the engine."""
