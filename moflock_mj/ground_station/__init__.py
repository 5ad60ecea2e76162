"""The client side: vehicles as seen from the ground, and what they are asked for."""
