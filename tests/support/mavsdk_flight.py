"""Flight with MAVSDK in its own process: `python mavsdk_flight.py URL`; prints the observed values as JSON."""

from __future__ import annotations

import asyncio
import json
import sys

from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.offboard import OffboardAsync
from mavsdk.asyncio.plugins.param import ParamAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from mavsdk.plugins.offboard import VelocityNedYaw

ALTITUDE = 3.0


async def fly(url):
    """Connect, wait for health, arm, take off, fly with velocity setpoints, and land; return the observed values."""
    seen = {}
    async with Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION)) as mavsdk:
        await mavsdk.add_any_connection(url)
        system = await mavsdk.first_autopilot(timeout_s=20)
        seen["autopilot"] = (await system.autopilot_type()).name
        telemetry, action, offboard = TelemetryAsync(system), ActionAsync(system), OffboardAsync(system)
        # ArduPilot sends none of these without a request; PX4 is not affected.
        for stream in ("health", "position", "velocity_ned", "landed_state", "battery", "gps_info"):
            await getattr(telemetry, f"set_rate_{stream}")(10.0)
        async for health in telemetry.subscribe_health():
            if health.is_armable and health.is_global_position_ok and health.is_home_position_ok:
                break
        seen["battery"] = (await telemetry.battery()).remaining_percent
        seen["satellites"] = (await telemetry.gps_info()).num_satellites
        seen["parameters"] = len((await ParamAsync(system).get_all_params()).float_params)
        await action.set_takeoff_altitude(ALTITUDE)
        await action.arm()
        await action.takeoff()
        async for position in telemetry.subscribe_position():
            if position.relative_altitude_m > ALTITUDE - 0.15:
                break
        seen["altitude"] = position.relative_altitude_m
        await offboard.set_velocity_ned(VelocityNedYaw(0.0, 0.0, 0.0, 90.0))
        async for mode in telemetry.subscribe_flight_mode():
            if mode.name in ("HOLD", "OFFBOARD"):  # the take-off is over
                break
        await offboard.start()
        await offboard.set_velocity_ned(VelocityNedYaw(2.0, -1.0, 0.0, 90.0))
        await asyncio.sleep(3.0)
        seen["mode"] = (await telemetry.flight_mode()).name
        velocity = await telemetry.velocity_ned()
        seen["velocity"] = [velocity.north_m_s, velocity.east_m_s, velocity.down_m_s]
        await offboard.stop()
        await action.land()
        async for armed in telemetry.subscribe_armed():
            if not armed:
                break
        seen["landed"] = (await telemetry.landed_state()).name
    return seen


print(json.dumps(asyncio.run(asyncio.wait_for(fly(sys.argv[1]), 90))))
