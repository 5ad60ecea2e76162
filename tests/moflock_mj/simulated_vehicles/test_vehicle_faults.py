"""Injected faults: their texts and files, and what they do to a link."""

from __future__ import annotations

import pytest

from moflock_mj.errors import FleetError
from moflock_mj.mavlink.dialect import mavlink
from moflock_mj.simulated_vehicles.ardupilot import LOITER
from moflock_mj.simulated_vehicles.vehicle_faults import VehicleFault, check_faults, load_faults
from tests.support.ground_station import GroundStation, fleet_of


def faulty(text, *, number=0, **plan):
    return GroundStation(fleet_of("ardupilot", faults=[VehicleFault.from_text(text)], **plan), number)


def test_a_text():
    assert VehicleFault.from_text("vehicle=3, at=20,kind=gps_loss,duration=10") == VehicleFault(
        vehicle=3, kind="gps_loss", at=20.0, duration=10.0
    )
    assert VehicleFault.from_text("vehicle=all,kind=link_delay,delay=0.5") == VehicleFault(kind="link_delay", delay=0.5)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "must be key=value"),
        ("vehicle=1", "kind: ''.*one of gps_loss"),
        ("kind=link_loss", "share: is missing: link_loss needs it"),
        ("kind=gps_loss,share=1", "share: 1.0 does not apply to gps_loss"),
        ("vehicle=1,kind=fire", "kind: 'fire'.*one of gps_loss"),
        ("vehicle=1,kind=link_loss,share=1,when=3", "when: unknown name"),
        ("vehicle=1,vehicle=2,kind=link_loss,share=1", "each key once"),
        ("vehicle=-1,kind=link_loss,share=1", "vehicle: -1 is out of bounds"),
        ("vehicle=1.5,kind=link_loss,share=1", "vehicle: 1.5.*a whole number"),
        ("vehicle=1,kind=link_loss,share=1,at=nan", "at: nan is not a finite number"),
        ("vehicle=1,kind=link_loss,share=1,at=soon", "at: 'soon' is of the wrong type"),
        ("vehicle=1,kind=link_loss,share=2", "share: 2.0.*at least 0 and at most 1"),
    ],
)
def test_a_bad_text(text, words):
    with pytest.raises(FleetError, match=words):
        VehicleFault.from_text(text)


def test_a_file(tmp_path):
    path = tmp_path / "faults.toml"
    path.write_text(
        '[[faults]]\nvehicle = 1\nkind = "cannot_transmit"\nat = 2\n[[faults]]\nkind = "link_delay"\ndelay = 1\n'
    )
    assert [fault.kind for fault in load_faults(path)] == ["cannot_transmit", "link_delay"]
    path.write_text("vehicle = 1")
    with pytest.raises(FleetError, match="nothing but tables"):
        load_faults(path)
    path.write_text("[[faults")
    with pytest.raises(FleetError, match="not TOML"):
        load_faults(path)
    with pytest.raises(FleetError, match="No such file"):
        load_faults(tmp_path / "absent")


def test_a_drone_that_there_is_not():
    with pytest.raises(FleetError, match=r"vehicle 4.*at most 3"):
        check_faults([VehicleFault.from_text("vehicle=4,kind=link_loss,share=1")], 4)


def test_a_silent_vehicle_neither_sends_nor_hears_and_comes_back():
    station = faulty("vehicle=0,kind=link_loss,share=1,at=6,duration=5")
    station.wait(1.9)
    station.received.clear()
    station.wait(4.9)
    assert not station.received
    assert station.station.vehicle.ground_heard < 6
    station.wait(2.0)
    assert len(station.received["HEARTBEAT"]) == 2


def test_a_lossy_link_loses_its_share_and_the_sequence_shows_it():
    station = faulty("vehicle=0,kind=link_loss,share=0.3")
    for _ in range(20):  # a command may be lost
        station.send(mavlink.MAVLink_command_long_message(1, 1, 511, 0, 32, 20_000, 0, 0, 0, 0, 0))
    station.wait(20.0)
    got, lost = station.endpoint.counts.received, station.endpoint.counts.lost
    assert lost / (got + lost) == pytest.approx(0.3, abs=0.06)


def test_a_delayed_link():
    station = faulty("vehicle=0,kind=link_delay,delay=0.5")
    asked = station.fleet.time
    station.send(mavlink.MAVLink_timesync_message(0, 1))
    assert station.wait(3.0, until=lambda: "TIMESYNC" in station.received)
    assert station.fleet.time - asked == pytest.approx(1.0, abs=0.05)
    assert station.latest("TIMESYNC").tc1 / 1e9 == pytest.approx(asked + 0.5, abs=0.03)


def test_a_vehicle_that_takes_anothers_system_id():
    station = faulty("vehicle=1,kind=duplicate_id,system=1,at=6,duration=4", number=1, vehicles=2)
    station.wait(1.5)
    assert {message.get_srcSystem() for message in station.received["HEARTBEAT"]} == {2}
    station.wait(2.0)
    assert station.latest("HEARTBEAT").get_srcSystem() == 1
    station.wait(5.0)
    assert station.latest("HEARTBEAT").get_srcSystem() == 2


def test_a_battery_that_is_low_of_a_sudden():
    station = faulty("vehicle=0,kind=low_battery,charge=0.2,at=5")
    assert station.vehicle.battery.remaining > 0.99
    station.wait(2.0)
    assert station.vehicle.battery.remaining == pytest.approx(0.2, abs=0.01)


def test_a_pilot_takes_over():
    station = faulty("vehicle=0,kind=pilot,at=12")
    station.take_off(4.0)
    station.wait(6.0)
    assert station.vehicle.mode == LOITER
    assert station.vehicle.height() == pytest.approx(4.0, abs=0.2)
