"""A sensible rig.toml from a few figures, and the nominal arms that come with the program."""
