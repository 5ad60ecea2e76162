"""MCAP logs: writing, reading, recovery and export."""
