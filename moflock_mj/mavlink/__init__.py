"""MAVLink: links, signing, and simulated vehicles that answer as real ones do."""
