"""Statistics of evaluations: PCA, sensitivity, published values."""
