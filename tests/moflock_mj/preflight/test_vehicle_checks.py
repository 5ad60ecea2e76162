"""What a vehicle says of itself, graded: all is well when a good vehicle speaks, and each row has what fails it."""

from __future__ import annotations

import pytest

from moflock_mj import Scenario
from moflock_mj.ground_station.remote_vehicle import RemoteVehicle
from moflock_mj.mavlink.dialect import mavlink
from moflock_mj.mavlink.frames import Origin
from moflock_mj.preflight.results import CheckResult
from moflock_mj.preflight.vehicle_checks import battery_item, link_items, readiness
from tests.support.ground_station import fleet_of

SCENARIO = Scenario(arena_side=200.0)
AUTOPILOTS = ("ardupilot", "px4")
TOLD = (
    "SYS_STATUS", "GPS_RAW_INT", "GLOBAL_POSITION_INT", "BATTERY_STATUS", "HOME_POSITION", "EXTENDED_SYS_STATE",
    "EKF_STATUS_REPORT", "ESTIMATOR_STATUS",
)  # fmt: skip
NUMBERS = {message.msgname: number for number, message in mavlink.mavlink_map.items()}
MAG = mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG
PREARM = mavlink.MAV_SYS_STATUS_PREARM_CHECK


@pytest.fixture(scope="module", params=AUTOPILOTS)
def station(request):
    """A vehicle of our fleet whose estimator is ready, on the ground."""
    return fleet_of(request.param).stations[0]


class Listener:
    """A ground station's view of a vehicle that says what it says, but for what is changed."""

    def __init__(self, station, changes=None, *, without=()):
        self.station, self.changes, self.time = station, changes or {}, 0.0
        self.remote = RemoteVehicle(1, "here", is_local=True, send=lambda _: None, clock=lambda: self.time)
        self.autopilot = station.vehicle.autopilot
        self.hear(*({"HEARTBEAT", *TOLD} - {*without}))

    def hear(self, *names):
        for name in names:
            telemetry = self.station.telemetry
            message = telemetry.heartbeat() if name == "HEARTBEAT" else telemetry.make(NUMBERS[name])
            if message is None:
                continue  # the other autopilot's
            for field, value in self.changes.get(name, {}).items():
                old = getattr(message, field)
                setattr(message, field, value(old) if callable(value) else value)
            self.remote.note(message)

    def items(self, origin=None):
        profile = "px4" if self.autopilot == mavlink.MAV_AUTOPILOT_PX4 else "ardupilot"
        found = readiness(self.remote, profile, origin or Origin(), SCENARIO)
        return {item.name: item for item in found}


def without(bits):
    return lambda old: old & ~bits


def test_a_good_vehicle_passes(station):
    assert {item.result for item in Listener(station).items().values()} == {CheckResult.PASS}


@pytest.mark.parametrize(
    ("name", "changes", "result", "value"),
    [
        ("arming checks", {"SYS_STATUS": {"onboard_control_sensors_health": without(PREARM)}}, "running", "no reason"),
        ("sensors", {"SYS_STATUS": {"onboard_control_sensors_health": without(MAG)}}, "running", "3d_mag"),
        ("sensors", {"SYS_STATUS": {"onboard_control_sensors_health": without(MAG),
                                    "onboard_control_sensors_present": without(MAG)}}, "running", "3d_mag"),
        ("GPS fix", {"GPS_RAW_INT": {"fix_type": 2}}, "running", 2.0),
        ("GPS satellites", {"GPS_RAW_INT": {"satellites_visible": 5}}, "running", 5.0),
        ("GPS HDOP", {"GPS_RAW_INT": {"eph": 141}}, "running", 1.41),
        ("GPS horizontal accuracy", {"GPS_RAW_INT": {"h_acc": 5100}}, "running", 5.1),
        ("GPS speed accuracy", {"GPS_RAW_INT": {"vel_acc": 1100}}, "running", 1.1),
        ("disarmed, on the ground", {"HEARTBEAT": {"base_mode": lambda old: old | 128}}, "failure", "armed, on the"),
        ("disarmed, on the ground", {"EXTENDED_SYS_STATE": {"landed_state": 2}}, "failure", "in the air"),
        ("disarmed, on the ground", {"EXTENDED_SYS_STATE": {"landed_state": 0}}, "running", "not reported"),
        ("home", {"HOME_POSITION": {"latitude": lambda old: old + 1000}}, "failure", pytest.approx(11.1, abs=0.1)),
        ("home in the arena", {"HOME_POSITION": {"latitude": lambda old: old + 9100}}, "failure",
         pytest.approx(1, abs=1)),
    ],
)  # fmt: skip
def test_each_row_has_what_fails_it(station, name, changes, result, value):
    item = Listener(station, changes).items()[name]
    assert item.result == result
    assert value in item.value if isinstance(value, str) else item.value == value
    assert item.advice


@pytest.mark.parametrize(
    ("name", "autopilot", "message", "changes"),
    [
        ("estimator", "ardupilot", "EKF_STATUS_REPORT", {"flags": 0xA7}),
        ("estimator", "ardupilot", "EKF_STATUS_REPORT", {"flags": 0x400}),
        ("estimator's compass variance", "ardupilot", "EKF_STATUS_REPORT", {"compass_variance": 0.81}),
        ("estimator's velocity variance", "ardupilot", "EKF_STATUS_REPORT", {"velocity_variance": float("nan")}),
        ("estimator", "px4", "ESTIMATOR_STATUS", {"flags": 0xA7}),
        ("estimator", "px4", "ESTIMATOR_STATUS", {"flags": 0x1BF}),
        ("estimator", "px4", "ESTIMATOR_STATUS", {"flags": 0x73F}),
        ("estimator's mag ratio", "px4", "ESTIMATOR_STATUS", {"mag_ratio": 0.9}),
        ("estimator's accuracy", "px4", "ESTIMATOR_STATUS", {"pos_horiz_accuracy": 5.5}),
        ("GPS horizontal accuracy", "px4", "GPS_RAW_INT", {"h_acc": 3100}),
        ("GPS speed accuracy", "px4", "GPS_RAW_INT", {"vel_acc": 600}),
    ],
)
def test_estimators_and_receivers_have_their_autopilots_limits(name, autopilot, message, changes):
    item = Listener(fleet_of(autopilot).stations[0], {message: changes}).items()[name]
    assert (item.result, bool(item.advice)) == (CheckResult.RUNNING, True)


@pytest.mark.parametrize(
    ("silent", "name"),
    [
        ("SYS_STATUS", "arming checks"),
        ("SYS_STATUS", "sensors"),
        ("GPS_RAW_INT", "GPS"),
        ("HOME_POSITION", "home"),
        ("GLOBAL_POSITION_INT", "home"),
        ("EXTENDED_SYS_STATE", "disarmed, on the ground"),
    ],
)
def test_what_is_not_reported_is_waited_for(station, silent, name):
    assert Listener(station, without=[silent]).items()[name].result is CheckResult.RUNNING


def test_what_was_reported_long_ago_is_not_the_present(station):
    listener = Listener(station)
    listener.time = 6.0
    items = listener.items()
    assert items["link alive"].result is CheckResult.FAILURE
    assert {items[name].result for name in ("sensors", "arming checks", "GPS", "estimator")} == {CheckResult.RUNNING}


def test_a_real_px4_that_stands_ready_passes():
    """As PX4 1.17 sent them: a bit of arming checks that is healthy without being present, a remote control that is
    missed, a position that is constant at rest, and no HDOP.
    """
    told = {
        "SYS_STATUS": {
            "onboard_control_sensors_present": 0x300C02F,
            "onboard_control_sensors_enabled": 0x301C02F,
            "onboard_control_sensors_health": 0x1320C83F,
        },
        "ESTIMATOR_STATUS": {"flags": 0x3BF},
        "GPS_RAW_INT": {"eph": 0, "epv": 0},
    }
    items = Listener(fleet_of("px4").stations[0], told).items()
    assert {item.result for item in items.values()} == {CheckResult.PASS}
    assert "GPS HDOP" not in items


def test_an_ardupilot_that_does_not_report_its_checks():
    listener = Listener(
        fleet_of("ardupilot").stations[0], {"SYS_STATUS": {"onboard_control_sensors_present": without(PREARM)}}
    )
    item = listener.items()["arming checks"]
    assert (item.result, item.value) == (CheckResult.WARNING, "not reported")


def test_why_a_px4_would_not_arm_is_shown_with_its_mode():
    listener = Listener(
        fleet_of("px4").stations[0],
        {"SYS_STATUS": {"onboard_control_sensors_health": without(PREARM)}, "HEARTBEAT": {"custom_mode": 6 << 16}},
    )
    text = mavlink.MAVLink_statustext_message(4, b"Preflight Fail: heading estimate not stable\t")
    listener.remote.note(text)
    item = listener.items()["arming checks"]
    assert item.value == "Preflight Fail: heading estimate not stable, in OFFBOARD"


def test_why_a_vehicle_would_not_arm_is_shown():
    """As ArduCopter's status texts have it, in a reason and not a bare bit."""
    listener = Listener(
        fleet_of("ardupilot").stations[0],
        {"SYS_STATUS": {"onboard_control_sensors_health": without(PREARM)}},
    )
    text = mavlink.MAVLink_statustext_message(2, b"PreArm: Compass not calibrated")
    listener.remote.note(text)
    item = listener.items()["arming checks"]
    assert "Compass not calibrated" in str(item.value)


def test_a_healthy_bit_does_not_hide_that_there_is_no_position():
    """ArduCopter: the bit came 18 s before the position."""
    fleet = fleet_of("ardupilot", ready=False, boot=8.0)
    while fleet.time < 3.0:
        fleet.tick()
    items = Listener(fleet.stations[0]).items()
    assert items["arming checks"].result is CheckResult.PASS
    assert items["estimator"].result is CheckResult.RUNNING
    assert items["home"].result is CheckResult.RUNNING


@pytest.mark.parametrize(
    ("remaining", "capacity", "energy", "result"),
    [
        (80, None, None, CheckResult.PASS),
        (49, None, None, CheckResult.FAILURE),
        (49, 6000.0, 15_000.0, CheckResult.PASS),
        (80, 1000.0, 100_000.0, CheckResult.FAILURE),
        (19, 1e6, 1.0, CheckResult.FAILURE),
        (-1, None, None, CheckResult.WARNING),
    ],
)
def test_the_battery_is_enough_for_the_flight_and_a_reserve(station, remaining, capacity, energy, result):
    changed = {"battery_remaining": remaining}
    listener = Listener(station, {"SYS_STATUS": changed, "BATTERY_STATUS": changed})
    item = battery_item(listener.remote, capacity, energy)
    assert item.result is result
    assert bool(item.advice) == (result is not CheckResult.PASS)


@pytest.mark.parametrize(
    ("name", "trip", "lost", "rate"),
    [
        ("link's round trip", 1.1, 0, 10.0),
        ("link's round trip", None, 0, 10.0),
        ("link's loss", 0.01, 10, 10.0),
        ("rate of positions", 0.01, 0, 4.0),
    ],
)
def test_a_bad_link(station, name, trip, lost, rate):
    remote = Listener(station).remote
    link = remote.link
    link.look(0.0)
    link.received, link.lost = link.received + 100, link.lost + lost
    link.look(5.0)
    link.round_trips.extend([] if trip is None else [trip])
    graded = {item.name: item.result for item in link_items(remote, SCENARIO, rate)}
    assert {name for name, result in graded.items() if result is CheckResult.FAILURE} == {name}
