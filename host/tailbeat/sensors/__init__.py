"""Camera and IMU."""
