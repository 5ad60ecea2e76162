"""The numbers by which logs are read: they never change, so that a log of today is read in years to come."""

from __future__ import annotations

from moflock_mj.log.schemas import CHANNELS, Metrics
from moflock_mj.metrics.fitness import Fitness
from moflock_mj.metrics.order_parameters import OrderParameters

METRICS = {
    "phi_wall": 1, "phi_vel": 2, "phi_corr": 3, "phi_coll": 4, "phi_disc": 5, "phi_cluster": 6,
    "F_wall": 7, "F_speed": 8, "F_corr": 9, "F_coll": 10, "F_disc": 11, "F_cluster": 12,
    "F_1": 13, "F_2": 14, "F_product": 15, "tick": 16, "state_digest": 17,
}  # fmt: skip
"""Fields of a message on /metrics; a new field gets a new number."""


def test_the_fields_of_metrics_have_the_numbers_that_they_always_had():
    numbers = {field.name: field.number for field in Metrics.DESCRIPTOR.fields}
    assert {name: numbers[name] for name in METRICS} == METRICS


def test_every_order_parameter_and_fitness_is_a_field_of_metrics():
    names = {field.name for field in Metrics.DESCRIPTOR.fields}
    assert {f"phi_{name}" for name in OrderParameters._fields} <= names
    assert {name if name.startswith("F_") else f"F_{name}" for name in Fitness._fields} <= names


def test_the_channels_are_in_the_order_that_gives_them_their_numbers():
    first = ["/swarm/points", "/tf", "/metrics", "/log", "/scene", "/sim/state", "/arena", "/mavlink"]
    assert list(CHANNELS)[: len(first)] == first
