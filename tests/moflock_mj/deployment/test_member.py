"""Who flies a vehicle: we, or somebody else, by the modes that its heartbeat shows."""

from __future__ import annotations

import pytest

from moflock_mj.deployment.member import Member
from moflock_mj.ground_station.piloting import FlightTask
from moflock_mj.ground_station.remote_vehicle import RemoteVehicle
from moflock_mj.mavlink.dialect import mavlink
from moflock_mj.mavlink.frames import Origin
from moflock_mj.simulated_vehicles.px4 import HOLD, LAND, OFFBOARD, POSITION, TAKEOFF


class Px4:
    """A vehicle that is in the modes that a test says."""

    def __init__(self, mode):
        self.orders = []
        self.remote = RemoteVehicle(1, "here", is_local=True, send=self.orders.append, clock=lambda: 0.0)
        self.show(mode)
        self.member = Member(0, self.remote, Origin())

    def show(self, mode):
        self.remote.note(mavlink.MAVLink_heartbeat_message(2, mavlink.MAV_AUTOPILOT_PX4, 157, mode, 4, 3))

    def is_ours(self, mode, now):
        self.show(mode)
        return self.member.update(now)


@pytest.fixture
def climbing():
    vehicle = Px4(HOLD)
    vehicle.show(TAKEOFF)
    vehicle.member.climb()
    return vehicle


def test_a_take_off_that_ends_while_an_order_is_under_way_is_nobody_elses(climbing):
    """A real PX4 was at its height in TAKEOFF, and in HOLD by itself just before it heard of OFFBOARD."""
    climbing.member.assign(FlightTask.OFFBOARD, 1.0)
    assert climbing.is_ours(TAKEOFF, 1.0)
    assert climbing.is_ours(HOLD, 1.1)
    assert climbing.is_ours(HOLD, 1.4)
    assert len(climbing.orders) == 2
    assert climbing.is_ours(OFFBOARD, 1.5)
    assert climbing.member.obeys
    assert not climbing.is_ours(HOLD, 1.6)


@pytest.mark.parametrize("mode", [LAND, POSITION])
def test_another_mode_is_somebody_elses(climbing, mode):
    climbing.member.assign(FlightTask.OFFBOARD, 1.0)
    assert climbing.is_ours(TAKEOFF, 1.0)
    assert not climbing.is_ours(mode, 1.1)
