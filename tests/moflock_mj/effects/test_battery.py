"""The battery: momentum theory, the published voltage curve, and what is left under load."""

from __future__ import annotations

import math

import numpy as np
import pytest

from moflock_mj import Scenario
from moflock_mj.dynamics.airframe_models import load_airframe
from moflock_mj.effects.battery import load_cells, make_battery, open_circuit_voltage
from moflock_mj.effects.rotor_power import power_factor, rotor_power
from moflock_mj.scenario import effect_configs
from tests.support.twins import battery_under_load

X500 = load_airframe("x500")


def test_hover_power_is_that_of_momentum_theory_and_lasts_as_long_as_published():
    thrust, area = X500.hover_thrust(), math.pi * X500.rotor_radius**2
    induced = math.sqrt(thrust / (2 * 1.225 * area))
    power = rotor_power(power_factor(X500), *4 * [thrust])
    assert power == pytest.approx(4 * thrust * induced / X500.rotor_efficiency)
    # Holybro: about 18 minutes of hover on 4S and 5000 mAh; Bitcraze: 7 minutes on one cell and 250 mAh.
    for name, minutes in (("x500", 18), ("crazyflie", 7)):
        airframe = load_airframe(name)
        energy = 3.7 * airframe.battery_cells * airframe.battery_capacity
        seconds = energy / rotor_power(power_factor(airframe), *4 * [airframe.hover_thrust()])
        assert seconds / 60 == pytest.approx(minutes, rel=0.05)


def test_the_voltage_curve_is_that_of_chen_and_rincon_mora():
    for charge in np.linspace(0, 1, 11):
        expected = -1.031 * math.exp(-35 * charge) + 3.685 + 0.2156 * charge - 0.1178 * charge**2 + 0.3201 * charge**3
        assert open_circuit_voltage(charge) == pytest.approx(expected)
    # Their figure: 4.1 V full, 3.8 V in the middle, 2.65 V empty.
    assert [open_circuit_voltage(c) for c in (1.0, 0.5, 0.0)] == pytest.approx([4.10, 3.80, 2.65], abs=0.01)


def test_the_load_agrees_with_its_slow_twin():
    cells = make_battery(Scenario(drones=9, battery=effect_configs.BatteryConfig()), X500)
    cells.charge[:] = np.linspace(0.1, 1, 9) * cells.capacity
    before, power = cells.charge.copy(), np.linspace(0, 900, 9)
    load_cells(cells, power, 2.0)
    full = 4 * open_circuit_voltage(1.0)
    for i in range(9):
        voltage, current = battery_under_load(4 * open_circuit_voltage(before[i] / cells.capacity), 0.02, power[i])
        assert cells.voltage[i] == pytest.approx(voltage)
        assert before[i] - cells.charge[i] == pytest.approx(current * 2.0)
        assert cells.lift[i] == pytest.approx((voltage / full) ** 2)


def test_no_more_power_than_a_battery_has_and_none_when_it_is_empty():
    cells = make_battery(
        Scenario(drones=2, battery=effect_configs.BatteryConfig(resistance=1.0, capacity=1000.0)), X500
    )
    cells.charge[1] = 0
    load_cells(cells, np.full(2, 1e4), 10.0)
    assert cells.voltage[0] == pytest.approx(2 * open_circuit_voltage(1.0))
    assert (cells.voltage[1], cells.lift[1]) == (0, 0)
    load_cells(cells, np.full(2, 1e4), 10.0)
    assert cells.charge[0] == 0
