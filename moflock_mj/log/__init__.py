"""MCAP logs: written, read, recovered, exported."""
