"""Deployment of a validated point on vehicles: `moflock deploy`."""
