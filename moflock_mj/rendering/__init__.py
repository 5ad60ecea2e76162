"""Flights as pictures of bodies: MuJoCo's renderer, video, interactive viewer."""
