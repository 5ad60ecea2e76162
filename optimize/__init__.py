"""Search over a policy's parameters, with validation and reports."""
