"""Rendering of flights with MuJoCo: video and interactive viewer."""
