"""A machine's geometry in the files that other programs run: one module per format, each with text(...)."""
