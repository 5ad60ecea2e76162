"""A ground station on a wire in memory: packets pass between real endpoints without sockets, as fast as can be."""

from __future__ import annotations

from moflock_mj.mavlink.dialect import GROUND_COMPONENT, GROUND_SYSTEM, mavlink
from moflock_mj.mavlink.endpoint import Endpoint
from moflock_mj.scenario.scenario import Scenario
from moflock_mj.simulated_vehicles.fleet import TICK, Fleet, FleetPlan

CALM = Scenario(sigma_outer=0.0, sigma_inner=0.0)
VELOCITY = 0xDC7
"""Type mask of a pure velocity."""


class Wire:
    """What an endpoint sends comes to `other` at once, as from `address`."""

    def __init__(self, other, address):
        self.other, self.address = other, address

    def sendto(self, packet, _):
        self.other.datagram_received(packet, self.address)

    def close(self):
        pass


class GroundStation:
    """Commands the vehicle of a number; keeps what it hears by message type."""

    def __init__(self, fleet, number=0, *, system=GROUND_SYSTEM, key=None, beats=True):
        self.fleet, self.station = fleet, fleet.stations[number]
        self.vehicle = self.station.vehicle
        self.heard = {}
        self.endpoint = Endpoint(system, self.note, component=GROUND_COMPONENT, key=key)
        self.endpoint.connection_made(Wire(self.station.endpoint, (f"station{system}", number)))
        self.station.endpoint.connection_made(Wire(self.endpoint, ("vehicle", number)))
        self.peer = self.endpoint.peer(("vehicle", number))
        self.beats = beats
        self.flown = 0

    def note(self, message, _):
        self.heard.setdefault(message.get_type(), []).append(message)

    def send(self, message):
        self.endpoint.send(message, self.peer)

    def wait(self, seconds, setpoint=None, until=None):
        """Let the fleet fly on with heartbeats at 1 Hz and a setpoint at 20 Hz; returns whether `until` came true."""
        for _ in range(round(seconds / TICK)):
            if self.beats and self.flown % round(1 / TICK) == 0:
                self.send(mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, 8, 0, 0, 4, 3))
            if setpoint is not None and self.flown % 3 == 0:
                self.send(setpoint)
            self.flown += 1
            self.fleet.tick()
            if until is not None and until():
                return True
        return until is None

    def latest(self, kind):
        return self.heard[kind][-1]

    def texts(self):
        """Status texts, put together from their chunks."""
        texts = []
        for message in self.heard.get("STATUSTEXT", []):
            if message.chunk_seq:
                texts[-1] += message.text
            else:
                texts.append(message.text)
        return texts

    def command(self, number, *params):
        """Send a COMMAND_LONG; returns the result that is acknowledged."""
        values = [*params, *[0.0] * (7 - len(params))]
        self.send(mavlink.MAVLink_command_long_message(self.vehicle.system, 1, number, 0, *values))
        acknowledged = self.latest("COMMAND_ACK")
        assert acknowledged.command == number
        return acknowledged.result

    def arm(self):
        return self.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)

    def mode(self, mode):
        """Ask for a mode by its number in HEARTBEAT."""
        if self.vehicle.autopilot == mavlink.MAV_AUTOPILOT_PX4:
            return self.command(mavlink.MAV_CMD_DO_SET_MODE, 1, mode >> 16 & 255, mode >> 24)
        return self.command(mavlink.MAV_CMD_DO_SET_MODE, 1, mode)

    def take_off(self, altitude):
        """Arm, take off, and wait for the height."""
        px4 = self.vehicle.autopilot == mavlink.MAV_AUTOPILOT_PX4
        if not px4:
            assert self.mode(4) == 0
        assert self.arm() == 0
        amsl = self.vehicle.origin.altitude + self.vehicle.home[2]
        assert self.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, altitude + (amsl if px4 else 0)) == 0
        assert self.wait(30, until=lambda: self.vehicle.height() > altitude - 0.2)

    def set_parameter(self, name, value):
        """Set a parameter as its vehicle's encoding wants it."""
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
    """A SET_POSITION_TARGET_LOCAL_NED of a velocity."""
    return mavlink.MAVLink_set_position_target_local_ned_message(
        0, system, 1, frame, mask, 0, 0, 0, north, east, down, 0, 0, 0, 0, 0
    )


def fleet_of(autopilot, *, ready=True, **plan):
    """A fleet without sockets; `ready`: flown until its positions can be used."""
    fleet = Fleet(FleetPlan(**{"autopilot": autopilot, "boot": 4.0, "scenario": CALM, **plan}))
    if ready:
        while fleet.time < fleet.plan.boot + 0.1:
            fleet.tick()
    return fleet
