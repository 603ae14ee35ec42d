"""The entry points of calib, a file a verb: what the commands and a notebook call alike."""
