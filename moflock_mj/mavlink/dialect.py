"""The MAVLink dialect of all links: `ardupilotmega`, which includes `common` and so both autopilots' messages.

It is imported directly, not through `mavutil`, which changes the dialect of the whole process.
"""

from __future__ import annotations

from typing import Any

import pymavlink.dialects.v20.ardupilotmega as mavlink

__all__ = ["AUTOPILOT_COMPONENT", "GROUND_COMPONENT", "GROUND_SYSTEM", "SIMULATED", "Message", "mavlink"]

Message = Any
"""A `pymavlink` message; the library has no type annotations."""

AUTOPILOT_COMPONENT = mavlink.MAV_COMP_ID_AUTOPILOT1
GROUND_COMPONENT = mavlink.MAV_COMP_ID_MISSIONPLANNER
GROUND_SYSTEM = 255
"""System id of the ground station; ArduPilot's ground-station failsafe watches only this id."""

SIMULATED = tuple(b"moflock\0")
"""`middleware_custom_version` of our simulated vehicles in AUTOPILOT_VERSION; real ones send a commit."""
