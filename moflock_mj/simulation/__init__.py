"""Simulation of a flight: setup, compiled loop, snapshots and results."""
