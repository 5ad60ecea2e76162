"""Simulated ArduPilot and PX4 vehicles that communicate over MAVLink."""
