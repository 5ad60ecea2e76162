"""Pre-flight checks: whether a point, in a scenario, may be flown by a set of vehicles."""
