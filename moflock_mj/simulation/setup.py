"""Setup of a flight from scenario and policy parameters: arena, limits, sensors, metric ranges."""

from __future__ import annotations

from typing import NamedTuple, cast

from controllers.policies.interface import SpeedLimits
from controllers.policies.registry import spec_of
from moflock_mj.metrics.order_parameters import MetricRanges
from moflock_mj.parameters.points import check_point
from moflock_mj.scenario.scenario import Scenario
from moflock_mj.sensing.gps import SensorModel


class FlightSetup(NamedTuple):
    """Constant components of a flight, simulated or deployed.

    Attributes:
        params: parameters of the policy, checked.
        scenario: scenario of the flight.
        arena: arena, whose type selects the implementation of the walls.
        limits: speed limits of the policy, m/s.
        sensors: model of GPS errors and communication.
        ranges: distances of the order parameters, m.
    """

    params: NamedTuple
    scenario: Scenario
    arena: NamedTuple
    limits: SpeedLimits
    sensors: SensorModel
    ranges: MetricRanges

    @classmethod
    def resolve(cls, params: NamedTuple, scenario: Scenario) -> FlightSetup:
        """Create the setup of a flight.

        Raises:
            PointError: the parameters are not valid.
        """
        params = check_point(params)
        return cls(
            params=params,
            scenario=scenario,
            arena=cast("NamedTuple", scenario.arena),
            limits=SpeedLimits(scenario.v_flock, scenario.v_max, scenario.v_rep_max),
            sensors=sensor_model(scenario),
            ranges=MetricRanges(spec_of(params).interaction_range(params, scenario.v_flock), scenario.r_coll),
        )


def sensor_model(scenario: Scenario) -> SensorModel:
    """Model of GPS errors and communication of a scenario."""
    return SensorModel(
        t_gps=scenario.t_gps,
        sigma_inner=scenario.sigma_inner,
        lambda_gps=scenario.lambda_gps,
        r_comm=scenario.r_comm,
        packet_loss=scenario.packet_loss_ratio / scenario.packet_loss_distance**2,
    )
