"""Where the flock flies: true state, constants, arenas, obstacles."""
