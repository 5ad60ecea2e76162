"""Ground station connected in memory: packets pass between real endpoints without sockets and without delay."""

from __future__ import annotations

from moflock_mj.mavlink.dialect import GROUND_COMPONENT, GROUND_SYSTEM, mavlink
from moflock_mj.mavlink.endpoint import Endpoint
from moflock_mj.scenario.scenario import Scenario
from moflock_mj.simulated_vehicles.fleet import TICK, Fleet, FleetPlan

CALM = Scenario(sigma_outer=0.0, sigma_inner=0.0)
VELOCITY = 0xDC7
"""Type mask of a setpoint with velocity only."""


class Wire:
    """Transport that delivers packets to `other` immediately, with the sender `address`."""

    def __init__(self, other, address):
        self.other, self.address = other, address

    def sendto(self, packet, _):
        self.other.datagram_received(packet, self.address)

    def close(self):
        pass


class GroundStation:
    """Ground station of one vehicle; it stores received messages by type."""

    def __init__(self, fleet, number=0, *, system=GROUND_SYSTEM, key=None, heartbeats=True):
        self.fleet, self.station = fleet, fleet.stations[number]
        self.vehicle = self.station.vehicle
        self.received = {}
        self.endpoint = Endpoint(system, self.note, component=GROUND_COMPONENT, key=key)
        self.endpoint.connection_made(Wire(self.station.endpoint, (f"station{system}", number)))
        self.station.endpoint.connection_made(Wire(self.endpoint, ("vehicle", number)))
        self.peer = self.endpoint.peer(("vehicle", number))
        self.heartbeats = heartbeats
        self.steps = 0

    def note(self, message, _):
        self.received.setdefault(message.get_type(), []).append(message)

    def send(self, message):
        self.endpoint.send(message, self.peer)

    def wait(self, seconds, setpoint=None, until=None):
        """Step the fleet, with heartbeats at 1 Hz and a setpoint at 20 Hz; return whether `until` became true."""
        for _ in range(round(seconds / TICK)):
            if self.heartbeats and self.steps % round(1 / TICK) == 0:
                self.send(mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, 8, 0, 0, 4, 3))
            if setpoint is not None and self.steps % 3 == 0:
                self.send(setpoint)
            self.steps += 1
            self.fleet.tick()
            if until is not None and until():
                return True
        return until is None

    def latest(self, kind):
        return self.received[kind][-1]

    def texts(self):
        """Status texts, joined from their chunks."""
        texts = []
        for message in self.received.get("STATUSTEXT", []):
            if message.chunk_seq:
                texts[-1] += message.text
            else:
                texts.append(message.text)
        return texts

    def command(self, number, *params):
        """Send a COMMAND_LONG and return the acknowledged result."""
        values = [*params, *[0.0] * (7 - len(params))]
        self.send(mavlink.MAVLink_command_long_message(self.vehicle.system, 1, number, 0, *values))
        acknowledged = self.latest("COMMAND_ACK")
        assert acknowledged.command == number
        return acknowledged.result

    def arm(self):
        return self.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)

    def mode(self, mode):
        """Request a mode by its number in HEARTBEAT."""
        if self.vehicle.autopilot == mavlink.MAV_AUTOPILOT_PX4:
            return self.command(mavlink.MAV_CMD_DO_SET_MODE, 1, mode >> 16 & 255, mode >> 24)
        return self.command(mavlink.MAV_CMD_DO_SET_MODE, 1, mode)

    def take_off(self, altitude):
        """Arm, take off, and wait until the altitude is reached."""
        px4 = self.vehicle.autopilot == mavlink.MAV_AUTOPILOT_PX4
        if not px4:
            assert self.mode(4) == 0
        assert self.arm() == 0
        amsl = self.vehicle.origin.altitude + self.vehicle.home[2]
        assert self.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, altitude + (amsl if px4 else 0)) == 0
        assert self.wait(30, until=lambda: self.vehicle.height() > altitude - 0.2)

    def set_parameter(self, name, value):
        """Set a parameter in the encoding of the vehicle."""
        parameters = self.vehicle.parameters
        parameters.set_value(name, value)
        message = parameters.message(name)
        self.send(
            mavlink.MAVLink_param_set_message(
                self.vehicle.system, 1, message.param_id.encode(), message.param_value, message.param_type
            )
        )
        assert self.latest("PARAM_VALUE").param_value == message.param_value


def velocity(north, east, down, *, frame=mavlink.MAV_FRAME_LOCAL_NED, system=1, mask=VELOCITY):
    """SET_POSITION_TARGET_LOCAL_NED message with a velocity, m/s."""
    return mavlink.MAVLink_set_position_target_local_ned_message(
        0, system, 1, frame, mask, 0, 0, 0, north, east, down, 0, 0, 0, 0, 0
    )


def fleet_of(autopilot, *, ready=True, **plan):
    """Fleet without sockets; with `ready`, it is stepped until its position estimates are valid."""
    fleet = Fleet(FleetPlan(**{"autopilot": autopilot, "boot": 4.0, "scenario": CALM, **plan}))
    if ready:
        while fleet.time < fleet.plan.boot + 0.1:
            fleet.tick()
    return fleet
