"""Reproducible studies for the documentation (`make paper`, `make physics`, `make validation`)."""
