"""What was commanded and seen, as arrays: reading, combining, masking, provenance."""
