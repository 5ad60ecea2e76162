"""Fences: shapes, and the protocol that uploads, lists and clears them."""

from __future__ import annotations

import pytest

from moflock_mj.mavlink.dialect import mavlink
from moflock_mj.mavlink.fence import Circle, Polygon, breaches
from moflock_mj.simulated_vehicles.ardupilot import LAND
from moflock_mj.simulated_vehicles.fence_protocol import ITEMS_MAX
from tests.support.ground_station import GroundStation, fleet_of, velocity

FENCE = mavlink.MAV_MISSION_TYPE_FENCE
CORNER, FORBIDDEN = 5001, 5002
SQUARE = ((-10.0, -10.0), (10.0, -10.0), (10.0, 10.0), (-10.0, 10.0))


@pytest.fixture
def station():
    return GroundStation(fleet_of("ardupilot"))


def items_of(station, corners=SQUARE, command=CORNER, count=None):
    origin, items = station.vehicle.origin, []
    for number, corner in enumerate(corners):
        latitude, longitude = origin.globe(*corner)
        items.append(
            mavlink.MAVLink_mission_item_int_message(
                1, 1, number, mavlink.MAV_FRAME_GLOBAL, command, 0, 1, count or len(corners), 0, 0, 0,
                round(latitude * 1e7), round(longitude * 1e7), 0, FENCE,
            )
        )  # fmt: skip
    return items


def upload(station, items):
    """Upload as the vehicle asks for it; returns the result."""
    station.received.pop("MISSION_ACK", None)
    station.send(mavlink.MAVLink_mission_count_message(1, 1, len(items), FENCE))
    for number, item in enumerate(items):
        assert station.latest("MISSION_REQUEST_INT").seq == number
        station.send(item)
    return station.latest("MISSION_ACK").type


def count(station, kind=FENCE):
    station.send(mavlink.MAVLink_mission_request_list_message(1, 1, kind))
    answer = station.latest("MISSION_COUNT")
    assert answer.mission_type == kind
    return answer.count


def test_inside_and_outside():
    inside = Polygon(SQUARE, True)
    assert not breaches([inside], 0, 0)
    assert breaches([inside], 11, 0)
    assert breaches([inside, Polygon(((-1, -1), (1, -1), (0, 1)), False)], 0, 0)
    assert breaches([Circle((0, 0), 5, True)], 3, 4.1)
    assert not breaches([Circle((0, 0), 5, True)], 3, 3.9)
    assert breaches([Circle((0, 0), 5, False)], 3, 3.9)
    assert not breaches([], 1e6, 0)
    horseshoe = Polygon(((0, 0), (6, 0), (6, 6), (4, 6), (4, 2), (2, 2), (2, 6), (0, 6)), True)
    assert [breaches([horseshoe], x, 4) for x in (1, 3, 5)] == [False, True, False]


def test_a_fence_is_uploaded_read_back_and_cleared(station):
    items = items_of(station)
    assert upload(station, items) == mavlink.MAV_MISSION_ACCEPTED
    assert count(station) == 4
    for number, item in enumerate(items):
        station.send(mavlink.MAVLink_mission_request_int_message(1, 1, number, FENCE))
        back = station.latest("MISSION_ITEM_INT")
        assert (back.seq, back.x, back.y, back.command, back.param1) == (number, item.x, item.y, CORNER, 4)
    station.send(mavlink.MAVLink_mission_clear_all_message(1, 1, FENCE))
    assert count(station) == 0
    assert station.vehicle.shapes == ()


def test_there_are_no_missions_and_no_rally_points(station):
    assert count(station, 0) == 0
    assert count(station, 2) == 0
    station.send(mavlink.MAVLink_mission_count_message(1, 1, 3, 0))
    assert station.latest("MISSION_ACK").type == mavlink.MAV_MISSION_UNSUPPORTED


def test_a_fence_that_is_none_is_refused_and_the_old_one_stays(station):
    upload(station, items_of(station))
    for items in (
        items_of(station, SQUARE[:2]),
        items_of(station, SQUARE, count=5),
        items_of(station, SQUARE, count=float("nan")),
        items_of(station, SQUARE, command=16),
        items_of(station, SQUARE[:1], command=5003, count=-1),
    ):
        assert upload(station, items) == mavlink.MAV_MISSION_INVALID
    station.send(mavlink.MAVLink_mission_count_message(1, 1, ITEMS_MAX + 1, FENCE))
    assert station.latest("MISSION_ACK").type == mavlink.MAV_MISSION_NO_SPACE
    assert count(station) == 4
    assert len(station.vehicle.shapes) == 1


def test_an_item_that_does_not_come_is_asked_for_again_and_then_given_up(station):
    station.send(mavlink.MAVLink_mission_count_message(1, 1, 4, FENCE))
    station.send(items_of(station)[2])  # out of order: the first is asked for again
    station.wait(8.0)
    requests = [request.seq for request in station.received["MISSION_REQUEST_INT"]]
    assert set(requests) == {0}
    assert 5 <= len(requests) <= 8
    assert station.latest("MISSION_ACK").type == mavlink.MAV_MISSION_OPERATION_CANCELLED


def test_an_uploaded_polygon_is_kept(station):
    upload(station, items_of(station))
    station.set_parameter("FENCE_ENABLE", 1)
    station.set_parameter("FENCE_ACTION", 2)
    station.take_off(5.0)
    station.wait(8.0, velocity(3, 0, 0))
    assert station.vehicle.mode == LAND


def test_a_polygon_is_watched_by_px4_without_further_ado():
    station = GroundStation(fleet_of("px4"))
    upload(station, items_of(station, tuple((x + 100, y) for x, y in SQUARE)))
    assert station.arm() == mavlink.MAV_RESULT_TEMPORARILY_REJECTED
    assert "Preflight Fail: Geofence violation" in station.texts()
