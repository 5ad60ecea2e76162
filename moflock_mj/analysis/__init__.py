"""Analyses based on flights: step response, identification, target tracking, verification."""
