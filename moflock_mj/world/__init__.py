"""World of a flight: true state, physical constants, arenas and walls."""
