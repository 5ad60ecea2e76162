"""Pre-flight checks of a point, a scenario and a set of vehicles."""
