"""All frames jointly: cameras, lenses, marker positions and poses adjusted, and what they determine."""
