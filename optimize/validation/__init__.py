"""Whether a found parameter set is flyable: seeds, drones, wind, faults."""
