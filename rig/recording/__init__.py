"""Commands and observations as arrays: reading, combining, masking, provenance."""
