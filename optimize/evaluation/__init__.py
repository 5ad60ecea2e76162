"""Evaluation of parameter sets: flights, objectives, executors and archive."""
