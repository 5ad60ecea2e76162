"""Drag, downwash, ground effect: against their slow twins, closed forms and published figures."""

from __future__ import annotations

import math

import numpy as np
import pytest

from moflock_mj import Scenario
from moflock_mj.dynamics.airframe_models import airframe_names, load_airframe
from moflock_mj.effects.downwash import jet_speed, make_downwash, write_downwash
from moflock_mj.effects.drag import add_drag, make_drag
from moflock_mj.effects.ground_effect import ground_lift, make_ground_effect
from moflock_mj.effects.wind import make_wind
from moflock_mj.scenario import effect_configs
from moflock_mj.world.constants import AIR_DENSITY
from tests.support.compiled import compiled
from tests.support.twins import drag_force, quaternion_matrix, wash_forces
from tests.support.twins import jet_speed as slow_jet_speed

X500 = load_airframe("x500")
ADD_DRAG, WASH, LIFT = compiled(add_drag, 6), compiled(write_downwash, 2), compiled(ground_lift, 2)


def states(drones, seed=1):
    rng = np.random.default_rng(seed)
    qpos = rng.normal(size=(drones, 7))
    qpos[:, 3:] /= np.linalg.norm(qpos[:, 3:], axis=1, keepdims=True)
    return qpos, rng.normal(scale=6, size=(drones, 6)), rng.uniform(0, 8, (drones, 4))


@pytest.mark.parametrize("name", airframe_names())
def test_drag_agrees_with_its_slow_twin(name):
    scenario = Scenario(drones=20, wind=effect_configs.WindConfig(speed=9.0, direction=2.0, turbulence="severe"))
    wind = make_wind(scenario, 0.1, np.random.default_rng(2))
    drag = make_drag(scenario, load_airframe(name))
    qpos, qvel, thrust = states(20)
    force = np.ones((20, 6))
    ADD_DRAG(drag, wind, qpos, qvel, thrust, force)
    for i in range(20):
        airspeed = qvel[i, :3] - wind.velocity[:, i]
        rotation = quaternion_matrix(qpos[i, 3:])
        expected = drag_force(drag.body, drag.rotors, drag.weight, rotation, airspeed, thrust[i].sum())
        np.testing.assert_allclose(force[i], [*(1 + expected), 1, 1, 1], rtol=1e-12)


def test_level_hover_in_wind_is_pushed_by_the_published_coefficients():
    """PX4's model of the same vehicle: v^2 rho / (2 * 100 kg/m^2) + 0.15 1/s v."""
    wind = make_wind(Scenario(drones=1, wind=effect_configs.WindConfig(speed=8.0)), 0.1, np.random.default_rng(2))
    drag = make_drag(Scenario(wind=effect_configs.WindConfig()), X500)
    force = np.zeros((1, 6))
    qpos, hover = np.array([[0, 0, 20.0, 1, 0, 0, 0]]), np.full((1, 4), X500.hover_thrust())
    ADD_DRAG(drag, wind, qpos, np.zeros((1, 6)), hover, force)
    assert force[0, 0] / X500.mass == pytest.approx(64 * AIR_DENSITY / 200 + 0.15 * 8)
    assert force[0, 1:] == pytest.approx(0, abs=1e-12)
    # Along the rotors' axis only the body drags.
    fall = np.array([[0, 0, -8.0, 0, 0, 0]])
    ADD_DRAG(
        drag,
        make_wind(Scenario(drones=1, wind=effect_configs.WindConfig()), 0.1, np.random.default_rng(2)),
        qpos,
        fall,
        hover,
        force,
    )
    assert force[0, 2] / X500.mass == pytest.approx(64 * AIR_DENSITY / 200)


def test_a_section_overrides_the_airframes_figures():
    drag = make_drag(Scenario(drag=effect_configs.DragConfig(area=0.1, rotor=0.0)), X500)
    assert (drag.body, drag.rotors) == pytest.approx((AIR_DENSITY * 0.05, 0))


def test_jets_agree_with_their_slow_twin():
    downwash = make_downwash(Scenario(drones=12, downwash=effect_configs.DownwashConfig()), X500)
    qpos = np.random.default_rng(3).uniform(-4, 4, (12, 7))
    WASH(downwash, qpos)
    np.testing.assert_allclose(downwash.force, wash_forces(downwash, qpos[:, :3]), rtol=1e-12)
    assert (downwash.force > 0).sum() > 3
    assert downwash.force[np.argmax(qpos[:, 2])] == 0


def test_a_jet_carries_the_thrust_at_every_distance():
    """Its momentum flux is the thrust: exactly 4 B^2 S^2 / 3 / (sqrt(2) - 1), 0.957, by the measured B and S."""
    downwash = make_downwash(Scenario(downwash=effect_configs.DownwashConfig()), X500)
    assert downwash.fastest == pytest.approx(12.57, abs=0.01)
    for below in (3.0, 10.0, 30.0):
        r = np.linspace(0, 5 * below, 4001)
        speed = np.array([jet_speed(downwash, below, float(x) ** 2) for x in r])
        flux = np.trapezoid(2 * math.pi * AIR_DENSITY * speed**2 * r, r)
        assert flux / downwash.thrust == pytest.approx(4 * 5.8**2 * 0.094**2 / 3 / (math.sqrt(2) - 1), rel=1e-3)
        assert speed[0] == pytest.approx(slow_jet_speed(downwash.thrust, downwash.fastest, below, 0.0))
        assert speed[0] / 2 == pytest.approx(jet_speed(downwash, below, (0.094 * below) ** 2))


def test_two_drones_side_by_side_do_not_wash_each_other():
    downwash = make_downwash(Scenario(drones=2, downwash=effect_configs.DownwashConfig()), X500)
    WASH(downwash, np.array([[0, 0, 20.0, 1, 0, 0, 0], [1.0, 0, 20.0, 1, 0, 0, 0]]))
    assert (downwash.force == 0).all()


def test_the_ground_lifts_as_cheeseman_and_bennett_say():
    ground = make_ground_effect(Scenario(ground_effect=effect_configs.GroundEffectConfig(height=2.0)), X500)
    radius = X500.rotor_radius
    # At one rotor radius 1 / (1 - 1/16): the 6.7 % of their report; far up nothing; held below half a radius.
    assert LIFT(ground, 2 + radius) == pytest.approx(16 / 15)
    assert LIFT(ground, 2 + 2 * radius) == pytest.approx(64 / 63)
    assert LIFT(ground, 20.0) == pytest.approx(1, abs=1e-5)
    assert LIFT(ground, 2 + radius / 2) == LIFT(ground, 2.0) == LIFT(ground, -5.0) == pytest.approx(4 / 3)


@pytest.mark.parametrize("below", [0.5, 1.0, 2.0])
def test_the_jet_of_a_crazyflie_pushes_within_a_factor_of_two_of_the_force_fitted_to_flights(below):
    """gym-pybullet-drones (Panerati et al. 2021): 2267.18 (R / 4z)^2 N on the axis, R = 23.1348 mm; ours has 0.56."""
    downwash = make_downwash(Scenario(downwash=effect_configs.DownwashConfig()), load_airframe("crazyflie"))
    ours = downwash.drag * jet_speed(downwash, below, 0.0) ** 2
    assert 0.5 < ours / (2267.18 * (0.0231348 / (4 * below)) ** 2) < 1.0
