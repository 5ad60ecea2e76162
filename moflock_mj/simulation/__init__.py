"""A flight as it is simulated: built, stepped, snapshot, result."""
