"""Check before a flight that the vehicle can hold the wind and the speeds of a scenario."""

from __future__ import annotations

from typing import NamedTuple

from controllers.airframe import Airframe
from controllers.flight_control.gain_design import maximum_horizontal_force
from moflock_mj.effects.battery import Battery
from moflock_mj.effects.drag import Drag, wind_push
from moflock_mj.errors import ScenarioError
from moflock_mj.scenario.scenario import Scenario


def check_feasible(scenario: Scenario, airframe: Airframe, drag: NamedTuple, battery: NamedTuple) -> None:
    """Check mean wind and flock speed against the available force, and the battery against hover.

    The available force against drag is `maximum_horizontal_force`. The check ignores gusts.

    Args:
        scenario: speeds, wind and tilt.
        airframe: the vehicle.
        drag: drag of the scenario, or Off.
        battery: battery of the scenario, or Off.

    Raises:
        ScenarioError: one line that names the field, its value and the limit.
    """
    if scenario.battery is not None and isinstance(battery, Battery):
        lift = float(battery.lift[0])
        if lift * airframe.thrust_to_weight() <= 1:
            raise ScenarioError(
                f"battery.charge: {scenario.battery.charge:g} leaves the airframe {airframe.name} {lift:.0%} of its "
                f"thrust: to hover it must be over {1 / airframe.thrust_to_weight():.0%}"
            )
    if not isinstance(drag, Drag):
        return
    most = maximum_horizontal_force(airframe, scenario.tilt_max)
    speeds = {"v_flock": scenario.v_flock} | ({"wind.speed": scenario.wind.speed} if scenario.wind else {})
    for field, speed in speeds.items():
        push = wind_push(drag, speed, airframe.mass)
        if push > most:
            raise ScenarioError(
                f"{field}: {speed:g} m/s pushes the airframe {airframe.name} with {push:.3g} m/s^2: by its rotors and "
                f"tilt_max it must be at most {most:.3g} m/s^2"
            )
