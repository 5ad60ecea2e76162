"""The battery: power that the rotors draw, voltage that it leaves, thrust that the voltage allows."""

from __future__ import annotations

from math import exp, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.airframe import Airframe
from controllers.compiling import Off, hot_stage, implements, kernel, stage
from moflock_mj.effects.rotor_power import power_factor
from moflock_mj.scenario.scenario import Scenario


class Battery(NamedTuple):
    """The batteries of all drones.

    Attributes:
        cells: in series.
        capacity: C, charge of a full battery.
        resistance: ohm, of the whole battery.
        charge: (N,), C, that is left.
        voltage: (N,), V, under load.
        lift: (N,), thrust over that with a full battery under no load.
    """

    cells: float
    capacity: float
    resistance: float
    charge: NDArray[np.float64]
    voltage: NDArray[np.float64]
    lift: NDArray[np.float64]


def make_battery(scenario: Scenario, airframe: Airframe) -> Battery | Off:
    """The batteries of a scenario, before the rotors draw from them."""
    battery, drones = scenario.battery, scenario.drones
    if battery is None:
        return Off()
    capacity = airframe.battery_capacity if battery.capacity is None else battery.capacity
    resistance = airframe.battery_resistance if battery.resistance is None else battery.resistance
    cells = Battery(
        cells=float(airframe.battery_cells),
        capacity=capacity,
        resistance=resistance,
        charge=np.full(drones, battery.charge * capacity),
        voltage=np.empty(drones),
        lift=np.empty(drones),
    )
    load_cells(cells, np.full(drones, power_factor(airframe) * 4 * airframe.hover_thrust() ** 1.5), 0.0)
    return cells


@kernel
def open_circuit_voltage(charge: float) -> float:
    """Voltage of a lithium polymer cell under no load, V.

    M. Chen, G. A. Rincon-Mora: Accurate Electrical Battery Model Capable of Predicting Runtime and I-V Performance,
    IEEE Transactions on Energy Conversion 21(2), 2006, equation 2.

    Args:
        charge: share of the capacity that is left.
    """
    return -1.031 * exp(-35 * charge) + 3.685 + charge * (0.2156 + charge * (-0.1178 + charge * 0.3201))


@stage
def drain(battery: NamedTuple, power: NDArray[np.float64], duration: float) -> None:
    """Draw power from the batteries for a while.

    Args:
        battery: changes.
        power: (N,), W.
        duration: s.
    """


@hot_stage
def battery_lift(battery: NamedTuple, i: int) -> float:
    """Thrust of drone i's rotors over that with a full battery under no load."""
    return 1.0


@implements(battery_lift, Battery)
def _lift(battery: Battery, i: int) -> float:
    return float(battery.lift[i])


@kernel
def load_cells(battery: Battery, power: NDArray[np.float64], duration: float) -> None:
    """Draw power (N,), W, for a duration, s; then tell voltage and lift under that load.

    The current I at which the terminals give the power, V I with V = V_open - R I, is the smaller root of a quadratic
    equation; more power than V_open^2 / 4R is not to be had. Rotor speed goes with voltage and thrust with its square.
    An empty battery gives nothing.
    """
    full = battery.cells * open_circuit_voltage(1.0)
    for i in range(power.size):
        share = battery.charge[i] / battery.capacity
        if share <= 0:
            battery.voltage[i] = 0.0
            battery.lift[i] = 0.0
            continue
        open_circuit = battery.cells * open_circuit_voltage(share)
        root = sqrt(max(open_circuit * open_circuit - 4 * battery.resistance * power[i], 0.0))
        voltage = (open_circuit + root) / 2
        battery.charge[i] = max(battery.charge[i] - power[i] / voltage * duration, 0.0)
        battery.voltage[i] = voltage
        battery.lift[i] = (voltage / full) ** 2


@implements(drain, Battery)
def _drain_cells(battery: Battery, power: NDArray[np.float64], duration: float) -> None:
    load_cells(battery, power, duration)
