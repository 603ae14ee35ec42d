"""Effects as text: on a command line, in files of a user's own, as formulas, and the catalogue listed and as a page."""
