"""What physics was left out: found plane by plane, named, fitted, proven on what was held out."""
