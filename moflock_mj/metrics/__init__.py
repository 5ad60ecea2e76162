"""Metrics of a flight: order parameters, fitness, tracking, events and verdict."""
