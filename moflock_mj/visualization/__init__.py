"""Figures, HTML pages and live views of flights, without OpenGL."""
