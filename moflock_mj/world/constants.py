"""Physical constants."""

from __future__ import annotations

AIR_DENSITY = 1.225
"""kg/m^3 at sea level (ISO 2533, International Standard Atmosphere)."""


GRAVITY = 9.81
"""m/s^2, as in the flock's model."""
