"""Physical constants."""

from __future__ import annotations

from controllers.airframe import GRAVITY

__all__ = ["AIR_DENSITY", "GRAVITY"]

AIR_DENSITY = 1.225
"""kg/m^3 at sea level (ISO 2533, International Standard Atmosphere)."""
