"""All frames together: cameras, lenses, markers' places and poses adjusted, and what they determine."""
