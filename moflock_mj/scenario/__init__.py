"""Scenario of a flight: its declaration and its checks, without computation."""
