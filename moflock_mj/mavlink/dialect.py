"""The MAVLink dialect of all links. `ardupilotmega` contains `common`, and so both autopilots' messages.

Imported as a class, never by `mavutil`, which changes the dialect of the whole process.
"""

from __future__ import annotations

from typing import Any

import pymavlink.dialects.v20.ardupilotmega as mavlink

__all__ = ["AUTOPILOT_COMPONENT", "GROUND_COMPONENT", "GROUND_SYSTEM", "SIMULATED", "Message", "mavlink"]

Message = Any
"""A `pymavlink` message; its library has no types."""

AUTOPILOT_COMPONENT = mavlink.MAV_COMP_ID_AUTOPILOT1
GROUND_COMPONENT = mavlink.MAV_COMP_ID_MISSIONPLANNER
GROUND_SYSTEM = 255
"""What a ground station calls itself; ArduPilot listens to no other for its ground-station failsafe."""

SIMULATED = tuple(b"moflock\0")
"""Our simulated vehicles' `middleware_custom_version` in AUTOPILOT_VERSION, where real ones have a commit."""
