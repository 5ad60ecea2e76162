"""Policies, from the observations of a drone to its desired velocity: one module per policy, and a registry."""
