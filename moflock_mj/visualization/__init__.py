"""Flights as figures, pages and live views, without OpenGL."""
