"""Images to poses: corners, their places and covariance, cameras and targets adjusted together."""
