"""From a validated point to vehicles in the air: `moflock deploy`."""
