"""What air, wear and failure do to a drone: one effect a file."""
