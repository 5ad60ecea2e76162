"""The reproducible studies of the documentation (`make paper`, `make physics`, `make validation`)."""
