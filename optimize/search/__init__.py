"""Search loop, algorithms, allocation of flights, and the resulting front."""
