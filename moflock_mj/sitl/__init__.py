"""Software in the loop: real autopilot programs fly simulated rigid bodies and receive simulated sensor data."""
