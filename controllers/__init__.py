"""What runs on a drone: flocking policy, velocity, attitude and rate loops, rotors; and the design of their gains."""
