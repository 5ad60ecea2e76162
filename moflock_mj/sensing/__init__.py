"""Sensing and communication of each drone: GPS, packets, IMU."""
