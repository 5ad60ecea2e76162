"""Statistics of evaluations: principal components, sensitivity, and published values."""
