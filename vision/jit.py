"""How numba compiles: to files, without the interpreter's lock, in fast mathematics that still knows what is infinite or no number."""

FAST = {"cache": True, "nogil": True, "error_model": "numpy", "fastmath": {"nsz", "arcp", "contract", "afn", "reassoc"}}
