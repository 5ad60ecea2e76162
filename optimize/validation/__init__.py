"""Validation of points on rigid bodies: verdicts over seeds, and faults."""
