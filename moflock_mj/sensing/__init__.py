"""What each drone knows: GPS, packets, IMU."""
