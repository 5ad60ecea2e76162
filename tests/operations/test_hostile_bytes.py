"""Hostile bytes into an endpoint: no crash, no state changed by what is not valid and addressed, flat memory."""

from __future__ import annotations

import dataclasses
import math
import random
import tracemalloc

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from moflock_mj.mavlink.dialect import mavlink
from moflock_mj.mavlink.endpoint import Endpoint
from moflock_mj.mavlink.signing import SigningKey
from moflock_mj.simulated_vehicles.fleet import AUTOPILOTS, Fleet, FleetPlan
from tests.support.fuzzing import Fuzzer, changeable_state, corpus
from tests.support.ground_station import GroundStation, fleet_of

KEY = SigningKey(bytes(range(32)))
BYTES = 200_000
"""Of each kind into each endpoint; `python -m tests.support.fuzzing` takes as many as you like."""

extreme = st.sampled_from([math.nan, math.inf, -math.inf, 1e38, -1e38, 1e-40, -0.0, 3.4028235e38])
number = st.one_of(extreme, st.floats(width=32), st.integers(-70_000, 70_000).map(float))


@pytest.fixture(params=sorted(AUTOPILOTS), scope="module")
def station(request):
    return GroundStation(fleet_of(request.param))


@pytest.fixture(params=sorted(AUTOPILOTS), scope="module")
def signed_station(request):
    return GroundStation(Fleet(FleetPlan(autopilot=request.param, boot=0.0), KEY), key=KEY)


def test_random_and_mutated_bytes_change_nothing(station):
    state = changeable_state(station.vehicle)
    fuzzer = Fuzzer(station.station.endpoint, seed=1)
    fuzzer.random_bytes(BYTES)
    fuzzer.mutated_bytes(BYTES)
    assert changeable_state(station.vehicle) == state
    assert station.station.endpoint.counts.dropped > 1000
    station.wait(0.1)


def test_memory_stays_flat(station):
    fuzzer = Fuzzer(station.station.endpoint, seed=2)
    fuzzer.random_bytes(50_000)
    fuzzer.mutated_bytes(50_000)
    tracemalloc.start()
    try:
        before, _ = tracemalloc.get_traced_memory()
        fuzzer.random_bytes(BYTES)
        fuzzer.mutated_bytes(BYTES)
        after, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert after - before < 50_000


def test_every_message_unsigned_or_foreign_changes_nothing(signed_station):
    """Each message of the dialect, unsigned, signed with another key, and signed but for another vehicle."""
    vehicle, endpoint = signed_station.vehicle, signed_station.station.endpoint
    state = changeable_state(vehicle)
    before = dataclasses.replace(endpoint.counts)
    stranger = Endpoint(255, lambda *_: None, component=190, key=SigningKey(bytes(32)))
    unsigned = Endpoint(255, lambda *_: None, component=190)
    messages = corpus(target=1)
    for message in messages:
        for sender in (stranger, unsigned):
            endpoint.datagram_received(sender.pack(message, sender.peer(("h", 1))), ("h", 1))
    assert endpoint.counts.unsigned - before.unsigned == 2 * len(messages)
    foreign = [message for message in corpus(target=77) if hasattr(message, "target_system")]
    for message in foreign:
        endpoint.datagram_received(signed_station.endpoint.pack(message, signed_station.peer), ("h", 1))
    assert endpoint.counts.foreign - before.foreign == len(foreign)
    assert endpoint.counts.received == before.received
    assert changeable_state(vehicle) == state


@pytest.mark.parametrize("autopilot", sorted(AUTOPILOTS))
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e38, -1e38])
def test_extreme_values_in_every_message_do_not_crash_a_flying_vehicle(autopilot, value):
    """Valid, authentic and addressed, so that it may obey; but it goes on, with a finite state."""
    station = GroundStation(fleet_of(autopilot))
    station.take_off(3.0)
    for message in corpus(target=1, value=value):
        station.send(message)
    station.wait(3.0)
    assert all(math.isfinite(number) for part in station.vehicle.body for number in part)
    assert abs(station.vehicle.body.position[0]) < 400
    parameters = station.vehicle.parameters
    assert all(math.isfinite(parameters[parameters.name(index)]) for index in range(len(parameters)))


@pytest.mark.parametrize("autopilot", sorted(AUTOPILOTS))
@pytest.mark.parametrize("value", [1e38, -1e38, 0.0])
def test_extreme_parameters_do_not_crash_a_flying_vehicle(autopilot, value):
    station = GroundStation(fleet_of(autopilot))
    station.take_off(3.0)
    parameters = station.vehicle.parameters
    for index in range(len(parameters)):
        parameters.set_value(parameters.name(index), value)
    station.wait(1.0)
    for command in (mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH, mavlink.MAV_CMD_NAV_LAND):
        station.command(command)
        station.wait(3.0)
    assert all(math.isfinite(number) for part in station.vehicle.body for number in part)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(command=st.integers(0, 65535), params=st.lists(number, min_size=7, max_size=7), target=st.integers(0, 255))
def test_any_command_is_answered_once_if_it_is_ours(station, command, params, target):
    station.received.clear()
    state = changeable_state(station.vehicle)
    station.send(mavlink.MAVLink_command_long_message(target, 1, command, 0, *params))
    if target in (0, 1):
        assert len(station.received["COMMAND_ACK"]) == 1
        station.wait(0.04)
    else:
        assert not station.received
        assert changeable_state(station.vehicle) == state


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    mask=st.integers(0, 65535),
    frame=st.integers(0, 255),
    fields=st.lists(number, min_size=11, max_size=11),
)
def test_any_setpoint_leaves_a_finite_wish(station, mask, frame, fields):
    station.send(mavlink.MAVLink_set_position_target_local_ned_message(0, 1, 1, frame, mask, *fields))
    wish = station.vehicle.setpoint
    if wish is not None:
        assert all(math.isfinite(part) for part in (*(wish.velocity or ()), *(wish.position or ())))
    station.wait(0.02)


@pytest.mark.parametrize("autopilot", sorted(AUTOPILOTS))
def test_random_payloads_with_a_right_checksum_do_not_crash_it(autopilot):
    station = GroundStation(fleet_of(autopilot))
    fuzzer = Fuzzer(station.station.endpoint, seed=5)
    for _ in range(20):
        fuzzer.valid_packets(500)
        station.wait(0.1)
    counts = station.station.endpoint.counts
    assert counts.received > 1000
    assert counts.foreign > 500
    assert all(math.isfinite(number) for part in station.vehicle.body for number in part)


@settings(max_examples=100, deadline=None)
@given(data=st.binary(max_size=600))
def test_any_datagram_is_taken(data):
    told = []
    endpoint = Endpoint(1, lambda message, _: told.append(message))
    endpoint.datagram_received(data, ("127.0.0.1", 5))
    assert not told
    assert endpoint.counts.malformed + endpoint.counts.unknown >= bool(data)


def test_the_seeded_fuzz_reaches_the_parser():
    """Mutants are not all refused at the first byte: some have a wrong checksum, some are whole by chance."""
    told = []
    endpoint = Endpoint(1, lambda message, _: told.append(message))
    packets = Fuzzer(endpoint, seed=3).packets
    assert len(packets) > 200
    for packet in random.Random(4).sample(packets, 50):
        endpoint.datagram_received(packet, ("h", 1))
    assert len(told) > 10
