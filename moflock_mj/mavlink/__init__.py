"""MAVLink: dialect, endpoints, signing, parameters, fences and frames."""
