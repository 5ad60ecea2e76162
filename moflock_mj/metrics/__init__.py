"""What is measured of a flight: order parameters, fitness, tracking, events, verdict."""
