"""Which parameter sets are flown next, and the front that results."""
