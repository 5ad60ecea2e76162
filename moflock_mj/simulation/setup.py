"""What a scenario and a policy's parameters say of a flight, resolved once: arena, limits, sensors, metric ranges."""

from __future__ import annotations

from typing import NamedTuple, cast

from controllers.policies.interface import SpeedLimits
from controllers.policies.registry import spec_of
from moflock_mj.metrics.order_parameters import MetricRanges
from moflock_mj.parameters.points import check_point
from moflock_mj.scenario.scenario import Scenario
from moflock_mj.sensing.gps import SensorModel


class FlightSetup(NamedTuple):
    """The parts of a flight that do not change in flight, whether it is simulated or deployed.

    Attributes:
        params: the policy's parameters, checked.
        scenario: what is flown.
        arena: its type chooses the walls.
        limits: speeds that the policy keeps, m/s.
        sensors: GPS errors and communication.
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
        """The setup of a flight.

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
    """GPS errors and communication of a scenario."""
    return SensorModel(
        t_gps=scenario.t_gps,
        sigma_inner=scenario.sigma_inner,
        lambda_gps=scenario.lambda_gps,
        r_comm=scenario.r_comm,
        packet_loss=scenario.packet_loss_ratio / scenario.packet_loss_distance**2,
    )
