"""N autopilots over real sockets and one world."""

from __future__ import annotations

import contextlib
import dataclasses
import socket
from pathlib import Path

import numpy as np
import pytest

from moflock_mj import Scenario
from moflock_mj.errors import MoflockError
from moflock_mj.scenario.faults import FaultConfig
from moflock_mj.sitl.lockstep import INTERFACES, LockStep, PhysicsPlan
from tests.support.autopilot_stand_in import STAND_INS

CALM = Scenario(sigma_inner=0.0, sigma_outer=0.0)
KINDS = tuple(INTERFACES)


@contextlib.contextmanager
def flight(kind, vehicles=1, *, notices=None, ended=None, **plan):
    """A world that listens at any free ports, as fast as it can, and its stand-ins, which hover at 1 m, 1.5 m, ..."""
    plan = PhysicsPlan(**{"autopilot": kind, "vehicles": vehicles, "port": 0, "speed": 100.0, "scenario": CALM, **plan})
    world = LockStep(plan, ([] if notices is None else notices).append, ended or (lambda _: None))
    world.open()
    with contextlib.ExitStack() as stack:
        stack.callback(world.close)
        pilots = [STAND_INS[kind](link.port, 1.0 + 0.5 * link.number) for link in world.links]
        for pilot in pilots:
            stack.enter_context(pilot.socket)
            pilot.send()
        assert world.gather(lambda: False)
        yield world, pilots


def fly(world, pilots, seconds):
    """Let them exchange for some simulated seconds."""
    for _ in range(round(seconds / world.period)):
        for pilot in pilots:
            pilot.send()
        assert world.step()
        for pilot in pilots:
            pilot.receive()


@pytest.mark.parametrize("kind", KINDS)
def test_stand_ins_take_off_and_hover(kind):
    with flight(kind, 2) as (world, pilots):
        start = world.bodies.qpos[:, :2].copy()
        fly(world, pilots, 5.0)
        np.testing.assert_allclose(world.bodies.qpos[:, 2], [1.0, 1.5], atol=0.1)
        np.testing.assert_allclose(world.bodies.qpos[:, :2], start, atol=0.3)
        assert np.abs(world.bodies.qvel).max() < 0.3
        assert all(link.counts.dropped == 0 and link.counts.restarts == 0 for link in world.links)
        assert all(abs(link.counts.received - 5.0 / world.period) <= 1 for link in world.links)


@pytest.mark.parametrize("kind", KINDS)
def test_motors_that_stand_leave_the_bodies_where_they_are(kind):
    with flight(kind, 2) as (world, pilots):
        start = world.bodies.qpos.copy()
        for pilot in pilots:
            pilot.height = -1e3  # down, that is: nothing of its motors
        fly(world, pilots, 1.0)
        np.testing.assert_allclose(world.bodies.qpos, start, atol=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_one_that_hangs_falls_and_the_others_go_on_and_it_may_come_back(kind):
    notices = []
    with flight(kind, 3, patience=0.2, notices=notices) as (world, pilots):
        fly(world, pilots, 3.0)
        hung, others = pilots[1], [pilots[0], pilots[2]]
        fly(world, others, 1.0)
        heights = world.bodies.qpos[:, 2]
        assert heights[1] < 0.2
        np.testing.assert_allclose(heights[[0, 2]], [1.0, 2.0], atol=0.2)
        assert [link.present for link in world.links] == [True, False, True]
        assert notices == ["autopilot 1 at 3.0 s: it has not answered for 0.2 s; its rotors stop"]
        hung.send()
        while len(notices) < 2:
            fly(world, others, world.period)
        assert notices[1].startswith("autopilot 1 at 4.")
        assert notices[1].endswith("it is there again")
        hung.receive()
        fly(world, pilots, 0.5)
        assert len(notices) == 2


@pytest.mark.parametrize("kind", KINDS)
def test_one_whose_program_has_ended_is_not_waited_for(kind):
    notices, ends = [], {}
    with flight(kind, 2, patience=60.0, notices=notices, ended=ends.get) as (world, pilots):
        fly(world, pilots, 0.1)
        ends[0] = "it has ended with status 1"
        fly(world, pilots[1:], 0.1)
        assert notices == ["autopilot 0 at 0.1 s: it has ended with status 1; its rotors stop"]


def test_a_px4_that_hangs_up_and_connects_again_flies_on_with_a_new_clock():
    with flight("px4", patience=0.2) as (world, pilots):
        fly(world, pilots, 1.0)
        pilots[0].socket.close()
        assert world.step()
        again = STAND_INS["px4"](world.links[0].port, 1.0)
        with again.socket:
            fly(world, [], 0.2)
            again.receive()
            assert again.time < 200_000
            assert world.links[0].counts.restarts == 1


def test_an_ardupilot_that_begins_anew_gets_a_new_clock():
    with flight("ardupilot") as (world, pilots):
        fly(world, pilots, 0.5)
        again = STAND_INS["ardupilot"](world.links[0].port, 1.0)
        with again.socket:
            world.links[0]._answered -= 1.0  # a second ago: the one before has died
            fly(world, [again], 0.1)
            assert again.state["timestamp"] == pytest.approx(0.1, abs=2 * world.period)
            assert world.links[0].counts.restarts == 1


def test_the_same_frame_moves_the_world_once_and_a_lost_answer_is_said_again():
    with flight("ardupilot") as (world, pilots):
        pilot, link = pilots[0], world.links[0]
        fly(world, pilots, 0.01)
        for _ in range(3):
            pilot.send()
        assert world.step()
        pilot.receive()
        before = pilot.state
        link.receive(0.0)
        assert not link.ready
        pilot.frame -= 1
        pilot.send()
        link._answered -= 1.0  # nothing came of the answer for a second
        link.receive(0.1)
        assert not link.ready
        pilot.receive()
        assert pilot.state == before


def test_a_px4_that_has_passed_over_its_sensors_gets_them_again():
    with flight("px4") as (world, pilots):
        pilot, link = pilots[0], world.links[0]
        fly(world, pilots, 0.1)
        before = pilot.time
        link.receive(0.0)
        assert not link.ready
        link._told -= 1.0  # a second ago
        link.receive(0.0)
        pilot.receive()
        assert pilot.time == before
        fly(world, pilots, 0.1)
        assert pilot.time == before + 100_000


def test_who_is_not_the_autopilot_is_not_heard():
    with flight("ardupilot") as (world, pilots), STAND_INS["ardupilot"](world.links[0].port, 9.0).socket as other:
        fly(world, pilots, 0.01)
        other.send(STAND_INS["ardupilot"].layout.pack(18458, 1200, 99, *[2000] * 16))
        fly(world, pilots, 0.01)
        assert world.links[0].counts.dropped == 1


@pytest.mark.parametrize("kind", KINDS)
def test_random_bytes_change_nothing(kind):
    rng = np.random.default_rng(1)
    with flight(kind) as (world, pilots):
        fly(world, pilots, 0.1)
        before = world.links[0].counts.received
        for _ in range(500):
            pilots[0].socket.send(rng.bytes(int(rng.integers(1, 300))))
            world.links[0].receive(0.0)
        assert world.links[0].counts.received == before
        assert world.links[0].counts.dropped > 100
        if kind == "ardupilot":  # a stream may hold half a packet, which takes the next one with it
            fly(world, pilots, 0.1)


@pytest.mark.parametrize("kind", KINDS)
def test_a_port_in_use_leaves_none_open(kind):
    plan = PhysicsPlan(autopilot=kind, vehicles=2, port=0, scenario=CALM)
    first = LockStep(plan)
    first.open()
    try:
        taken = first.links[1].port
        below = taken - plan.interface.port_step
        second = LockStep(dataclasses.replace(plan, port=below))
        with pytest.raises(MoflockError, match=rf"(UDP|TCP) 127.0.0.1:{taken}: Address already in use"):
            second.open()
        kind_of_socket = socket.SOCK_DGRAM if kind == "ardupilot" else socket.SOCK_STREAM
        with socket.socket(socket.AF_INET, kind_of_socket) as free:
            free.bind(("127.0.0.1", below))
    finally:
        first.close()


@pytest.mark.parametrize(
    ("plan", "words"),
    [
        ({"autopilot": "paparazzi"}, "physics-for: 'paparazzi'.*one of ardupilot, px4"),
        ({"vehicles": 0}, "vehicles: 0.*from 1 to 250"),
        ({"vehicles": 2, "port": 65530}, "port: 65530.*from 0 to 65525"),
        ({"speed": float("nan")}, "speed: nan"),
        ({"spacing": 0.7}, "spacing: 0.7 m.*the airframe's 0.754 m"),
        (
            {"scenario": CALM.replace(faults=(FaultConfig(kind="cannot_transmit", drone=0, at=1.0),))},
            "faults: not supported by real-time bodies",
        ),
    ],
)
def test_a_bad_plan(plan, words):
    with pytest.raises(MoflockError, match=words):
        LockStep(PhysicsPlan(**{"autopilot": "ardupilot", **plan}))


def test_a_state_that_is_no_longer_finite_ends_the_flight():
    with flight("ardupilot") as (world, pilots):
        fly(world, pilots, 0.01)
        world.bodies.qpos[0, 0] = np.nan
        pilots[0].send()
        with pytest.raises(MoflockError, match="the state is no longer finite"):
            world.step()


def test_a_scenarios_own_periods_need_not_fit():
    scenario = CALM.replace(duration=0.007, sample_period=0.007, t_gps=0.2, t_del=0.3, step=None)
    assert LockStep(PhysicsPlan(autopilot="ardupilot", scenario=scenario)).bodies.step == pytest.approx(1 / 1200)


def test_each_vehicle_has_the_port_that_its_instance_looks_for():
    assert PhysicsPlan(autopilot="ardupilot", vehicles=3).ports() == [9002, 9012, 9022]
    assert PhysicsPlan(autopilot="px4", vehicles=3).ports() == [4560, 4561, 4562]


def test_gathering_ends_when_asked_or_when_a_program_has_ended():
    plan = PhysicsPlan(autopilot="ardupilot", port=0, scenario=CALM)
    world = LockStep(plan, ended=lambda _: "it has ended with status 3: see output.txt")
    world.open()
    try:
        assert not world.gather(lambda: True)
        with pytest.raises(MoflockError, match="autopilot 0: it has ended with status 3"):
            world.gather(lambda: False)
    finally:
        world.close()


def test_physics_is_on_loopback_alone():
    world = LockStep(PhysicsPlan(autopilot="ardupilot", port=0, scenario=CALM))
    world.open()
    try:
        ours = f":{world.links[0].port:04X}"
        places = [line.split()[1] for line in Path("/proc/net/udp").read_text().splitlines()[1:]]
        assert [place for place in places if place.endswith(ours)] == [f"0100007F{ours}"]  # 127.0.0.1, as Linux has it
    finally:
        world.close()
