"""The parameters estimated pose by pose, and changes during the estimation."""
