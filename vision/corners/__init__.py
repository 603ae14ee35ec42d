"""Image -> marker corners with covariance."""
