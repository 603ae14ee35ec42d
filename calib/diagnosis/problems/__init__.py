"""What the engine is asked about: cameras and closures of a platform, poses of an arm."""
