"""What a machine is: its design, geometry, poses, tolerances, and how it moves."""
