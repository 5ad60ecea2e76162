"""Physical effects on drones: air, battery and faults, one module each."""
