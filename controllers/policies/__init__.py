"""Desired velocity of each drone from what it observes: one file per published policy, one registry."""
