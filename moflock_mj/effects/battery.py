"""Battery: voltage under the power of the rotors, and thrust at that voltage."""

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
    """Batteries of N drones.

    Attributes:
        cells: number of cells in series.
        capacity: charge of a full battery, C.
        resistance: internal resistance of the whole battery, ohm.
        charge: (N,), remaining charge, C.
        voltage: (N,), voltage under load, V.
        lift: (N,), thrust relative to that with a full battery without load.
    """

    cells: float
    capacity: float
    resistance: float
    charge: NDArray[np.float64]
    voltage: NDArray[np.float64]
    lift: NDArray[np.float64]


def make_battery(scenario: Scenario, airframe: Airframe) -> Battery | Off:
    """Create the batteries of a scenario, under the load of hover."""
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
    """Voltage of a lithium polymer cell without load, V.

    M. Chen, G. A. Rincon-Mora: Accurate Electrical Battery Model Capable of Predicting Runtime and I-V Performance,
    IEEE Transactions on Energy Conversion 21(2), 2006, equation 2.

    Args:
        charge: remaining charge as a fraction of the capacity.
    """
    return -1.031 * exp(-35 * charge) + 3.685 + charge * (0.2156 + charge * (-0.1178 + charge * 0.3201))


@stage
def drain(battery: NamedTuple, power: NDArray[np.float64], duration: float) -> None:
    """Draw power from the batteries; no effect without a battery model.

    Args:
        battery: the batteries; updated.
        power: (N,), electrical power of each drone, W.
        duration: duration of the load, s.
    """


@hot_stage
def battery_lift(battery: NamedTuple, i: int) -> float:
    """Thrust of drone i relative to that with a full battery without load; 1 without a battery model."""
    return 1.0


@implements(battery_lift, Battery)
def _lift(battery: Battery, i: int) -> float:
    return float(battery.lift[i])


@kernel
def load_cells(battery: Battery, power: NDArray[np.float64], duration: float) -> None:
    """Draw power (N,), W, for a duration, s, and update voltage and lift under that load.

    The current I follows from the power V I with V = V_open - R I, as the smaller root of a quadratic equation. The
    largest power is V_open^2 / 4R. Rotor speed is proportional to voltage, and thrust to its square. An empty battery
    supplies no voltage.
    """
    full = battery.cells * open_circuit_voltage(1.0)
    for i in range(power.size):
        state_of_charge = battery.charge[i] / battery.capacity
        if state_of_charge <= 0:
            battery.voltage[i] = 0.0
            battery.lift[i] = 0.0
            continue
        open_circuit = battery.cells * open_circuit_voltage(state_of_charge)
        root = sqrt(max(open_circuit * open_circuit - 4 * battery.resistance * power[i], 0.0))
        voltage = (open_circuit + root) / 2
        battery.charge[i] = max(battery.charge[i] - power[i] / voltage * duration, 0.0)
        battery.voltage[i] = voltage
        battery.lift[i] = (voltage / full) ** 2


@implements(drain, Battery)
def _drain_cells(battery: Battery, power: NDArray[np.float64], duration: float) -> None:
    load_cells(battery, power, duration)
