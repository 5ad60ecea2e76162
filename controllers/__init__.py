"""On-board control of a drone: flocking policies, velocity, attitude and rate loops, mixer, and gain design."""
