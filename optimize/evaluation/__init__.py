"""What one parameter set is worth: flights, objectives, executors, archive."""
