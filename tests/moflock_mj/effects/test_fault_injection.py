"""Faults of a scenario: how they are written, what is refused, when they act, and the compiled stages alone."""

from __future__ import annotations

import json

import numpy as np
import pytest

from controllers.compiling import Off
from moflock_mj import Scenario, load_point
from moflock_mj.dynamics.rotors import delivered_wrench
from moflock_mj.effects.fault_injection import NEVER, apply_faults, intervals_of, make_fault_schedule
from moflock_mj.errors import ScenarioError
from moflock_mj.metrics.events import fault_events
from moflock_mj.scenario import effect_configs
from moflock_mj.scenario.faults import KINDS, FaultConfig
from moflock_mj.scenario.schedule import Schedule
from moflock_mj.sensing.imu import correct_with_barometer_and_compass, make_imu
from moflock_mj.simulation.random_numbers import RandomStreams
from moflock_mj.simulation.realtime_bodies import RealtimeBodies
from moflock_mj.simulation.simulation import Simulation
from moflock_mj.world.state import TrueState
from optimize.validation.fault_trials import standard_faults
from tests.support.compiled import compiled
from tests.support.twins import acting

STRIKE, WRENCH, BEARINGS = (
    compiled(apply_faults, 3),
    compiled(delivered_wrench, 4),
    compiled(correct_with_barometer_and_compass, 6),
)
SHORT = Scenario(drones=4, arena_side=100.0, duration=12.0)


def broken(*faults, dynamics="rigid_body"):
    """The compiled faults of a scenario and its world; steps of 0.1 s."""
    scenario, step = SHORT.replace(faults=faults), SHORT.step_for(dynamics)
    return make_fault_schedule(scenario, dynamics, step, Schedule.of(scenario, step)), TrueState.at_rest(SHORT.drones)


def test_the_standard_set_has_every_kind_alone_and_is_kept_by_toml_and_json():
    for duration in (0.1, 600.0):
        flown = standard_faults(Scenario(duration=duration))
        assert {scenario.faults[0].kind for scenario in flown.values()} == set(KINDS)
        for scenario in flown.values():
            assert len(scenario.faults) == 1
            assert scenario.replace(faults=()) == Scenario(duration=duration)
            assert Scenario.from_toml(scenario.to_toml()) == scenario
            assert Scenario.from_dict(json.loads(json.dumps(scenario.to_dict()))) == scenario
            assert hash(scenario) == hash(scenario.replace())


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ('kind = "cannot_transmit"\ndrone = 40', r"faults\[1\]\.drone: 40.*at most 29"),
        ('kind = "cannot_transmit"\ndrone = -1', r"faults\[1\]\.drone: -1.*at least 0"),
        (
            'kind = "cannot_transmit"\ndrone = 1.5',
            r"faults\[1\]\.drone: 1\.5.*a whole number",
        ),
        ('kind = "cannot_transmit"', r"faults\[1\]\.drone: is missing: cannot_transmit affects one drone"),
        ('kind = "cannot_receive"\nat = 600', r"faults\[1\]\.at: 600 s.*the duration, 600 s"),
        ('kind = "cannot_receive"\nat = -1', r"faults\[1\]\.at: -1\.0.*at least 0 s"),
        ('kind = "cannot_receive"\nat = nan', r"faults\[1\]\.at: nan is not a finite number"),
        ('kind = "cannot_receive"\nduration = 0', r"faults\[1\]\.duration: 0\.0.*over 0 s"),
        (
            'kind = "cannot_receive"\nshare = 0.5',
            r"faults\[1\]\.share: 0\.5 does not apply to cannot_receive: it must be absent",
        ),
        ('kind = "cannot_receive"\nfor = 3', r"faults\[1\]\.for: unknown name"),
        ('kind = "fire"', r"faults\[1\]\.kind: 'fire'.*one of rotor_failure, gps_loss"),
        ("at = 3", r"faults\[1\]\.kind: ''.*one of rotor_failure"),
        ('kind = "link_loss"', r"faults\[1\]\.share: is missing: link_loss needs it"),
        ('kind = "link_loss"\nshare = 2', r"faults\[1\]\.share: 2\.0 is out of bounds: .* at most 1"),
        ('kind = "gps_jump"\njump = [1]', r"faults\[1\]\.jump: \[1\].*two numbers"),
        ('kind = "gps_jump"\njump = [1, "a"]', r"faults\[1\]\.jump: 'a'.*a number"),
        (
            'kind = "gps_jump"\njump = [1, 1e9]',
            r"faults\[1\]\.jump: .* is out of bounds: .* at most 100000 m",
        ),
        (
            'kind = "rotor_failure"\nrotor = 4\neffectiveness = 0',
            r"faults\[1\]\.rotor: 4 is out of bounds: .* at most 3",
        ),
        ('kind = "power_off"\ndrone = 1\nduration = 3', r"faults\[1\]\.duration: 3 s does not apply to power_off"),
    ],
)
def test_refusals_name_fault_field_value_and_limit(fault, words):
    with pytest.raises(ScenarioError, match=words) as refusal:
        Scenario.from_toml(f'[[faults]]\nkind = "cannot_receive"\n\n[[faults]]\n{fault}\n')
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("faults = 3", r"faults: 3.*tables, \[\[faults\]\]"),
        ("[faults]\nat = 3", r"faults: .*tables, \[\[faults\]\]"),
        ("faults = [3]", r"faults\[0\]: 3.*a table"),
    ],
)
def test_what_is_no_array_of_tables_is_refused(text, words):
    with pytest.raises(ScenarioError, match=words):
        Scenario.from_toml(text)


def test_faults_are_a_tuple_of_faults():
    with pytest.raises(ScenarioError, match=r"faults: \[\].*a tuple of Fault"):
        Scenario(faults=[])
    with pytest.raises(ScenarioError, match=r"faults: \(3,\) is of the wrong type"):
        Scenario(faults=(3,))


def test_a_point_mass_has_no_rotors_and_live_bodies_no_schedule():
    loss = FaultConfig(kind="rotor_failure", drone=0, rotor=0, effectiveness=0.5)
    with pytest.raises(ScenarioError, match=r"faults\[1\]\.kind: rotor_failure needs rigid bodies"):
        broken(FaultConfig(kind="cannot_receive"), loss, dynamics="point_mass")
    with pytest.raises(ScenarioError, match="faults: not supported by real-time bodies"):
        RealtimeBodies(SHORT.replace(faults=(loss,)), np.zeros((4, 2)), RandomStreams.of(1))


def test_a_fault_begins_and_ends_with_its_steps():
    assert intervals_of(FaultConfig(kind="cannot_receive", at=30.0, duration=10.0), 0.1) == (300, 400)
    assert intervals_of(FaultConfig(kind="cannot_receive", at=0.25, duration=0.1), 0.1) == (3, 4)
    assert intervals_of(FaultConfig(kind="cannot_receive", at=0.3), 0.1) == (3, NEVER)
    faults, world = broken(FaultConfig(kind="cannot_receive", at=0.7, duration=0.6, drone=2))
    cannot_receive = []
    for interval in range(20):
        STRIKE(faults, world, interval)
        cannot_receive.append(faults.cannot_receive.copy())
    times = np.arange(20) / 10
    np.testing.assert_array_equal(np.array(cannot_receive)[:, 2], (times >= 0.7) & (times < 1.3))
    assert np.array(cannot_receive)[:, [0, 1, 3]].max() == 0


def test_faults_together_are_those_of_the_slow_twin():
    rng = np.random.default_rng(2)

    def some(kind, **figures):
        drone = int(rng.integers(4)) if not KINDS[kind].of_all or rng.random() < 0.7 else None
        duration = None if not KINDS[kind].ends else round(rng.uniform(0.1, 5), 1)
        return FaultConfig(kind=kind, at=round(rng.uniform(0, 8), 1), duration=duration, drone=drone, **figures)

    drawn = [some(kind) for kind in ("gps_loss", "cannot_receive", "cannot_transmit", "power_off") for _ in range(2)]
    drawn += [some("gps_jump", jump=tuple(rng.normal(size=2))) for _ in range(6)]
    drawn += [some("link_loss", share=rng.random()) for _ in range(6)]
    drawn += [some("rotor_failure", rotor=int(rng.integers(4)), effectiveness=rng.random()) for _ in range(9)]
    faults, world = broken(*drawn)
    scenario = SHORT.replace(faults=tuple(drawn))
    for interval in range(0, 120):
        STRIKE(faults, world, interval)
        for i in range(4):
            act = {kind: acting(scenario, kind, i, interval / 10) for kind in KINDS}
            off = act["power_off"]
            assert faults.cannot_receive[i] == bool(act["cannot_receive"])
            assert faults.cannot_transmit[i] == bool(act["cannot_transmit"] + off)
            assert (faults.stopped[i] == bool(off)).all()
            assert faults.off_intervals[i] == max((round(interval - 10 * fault.at) for fault in off), default=-1)
            blind = max((interval / 10 - fault.at for fault in act["gps_loss"]), default=-1)
            assert faults.without_fix[i] == pytest.approx(blind, abs=1e-9)
            assert faults.jump[:, i] == pytest.approx(np.sum([[0, 0]] + [f.jump for f in act["gps_jump"]], axis=0))
            assert 1 - faults.loss[i] == pytest.approx(np.prod([1 - fault.share for fault in act["link_loss"]]))
            for rotor in range(4):
                left = [fault.effectiveness for fault in act["rotor_failure"] if fault.rotor == rotor]
                assert faults.effectiveness[i, rotor] == pytest.approx(np.prod(left))


def test_a_weak_rotor_delivers_its_share_and_no_other_does():
    gains = Simulation(load_point("A"), SHORT, "rigid_body", 1).body.design.gains
    thrust = np.arange(16.0).reshape(4, 4)
    faults, world = broken(FaultConfig(kind="rotor_failure", drone=3, rotor=1, effectiveness=0.25))
    STRIKE(faults, world, 0)
    assert WRENCH(faults, gains, thrust, 3) == pytest.approx(gains.wrench_matrix @ [12, 13 / 4, 14, 15])
    assert WRENCH(faults, gains, thrust, 2) == pytest.approx(gains.wrench_matrix @ thrust[2])
    assert WRENCH(Off(), gains, thrust, 3) == pytest.approx(gains.wrench_matrix @ thrust[3])


def test_an_estimator_without_gps_is_corrected_in_height_alone():
    faults, world = broken(FaultConfig(kind="gps_loss", drone=1))
    imu = make_imu(SHORT.replace(imu=effect_configs.ImuConfig(baro_noise=0.0, compass_noise=0.0)), 0.005, 0.1, world)
    STRIKE(faults, world, 0)
    qpos, qvel = np.zeros((4, 7)), np.ones((4, 6))
    qpos[:, 2:4] = 1
    BEARINGS(imu, qpos, qvel, np.zeros((2, 4)), np.zeros((1, 2, 4)), faults)
    estimated = imu.estimate
    assert (estimated.qvel[1, :2] == 0).all()
    assert (estimated.qvel[[0, 2, 3], :2] > 0).all()
    assert (estimated.qpos[:, 2] > 0).all()


def test_events_tell_beginning_and_end_once_however_the_flight_is_cut():
    scenario = SHORT.replace(
        faults=(
            FaultConfig(kind="gps_loss", at=3.0, duration=2.0, drone=1),
            FaultConfig(kind="cannot_receive", at=0.0),
            FaultConfig(kind="cannot_receive", at=1.0, duration=99.0),
        )
    )
    told = [event for k in range(-1, 120) for event in fault_events(scenario, 0.1, k * 10**8, (k + 1) * 10**8)]
    assert told == fault_events(scenario, 0.1, -1, 12 * 10**9)
    assert [(event.time_ns / 1e9, event.level, event.message, event.drone) for event in told] == [
        (0.0, "warning", "all drones: cannot receive", -1),
        (1.0, "warning", "all drones: cannot receive", -1),
        (3.0, "warning", "drone 1: no GPS", 1),
        (5.0, "warning", "drone 1: no GPS (over)", 1),
    ]
