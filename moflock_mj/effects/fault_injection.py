"""Fault injection: schedule of a scenario's faults, and the stages that apply them in the flight loop.

- rotor_failure: the rotor gives a fraction of its commanded thrust, at the speed and power of the full thrust, as with
  a broken blade. Battery and rotor drag do not change, and the controllers are not informed.
- gps_loss: the drone stops and holds, on inertial sensors. The error of its velocity stays that of the last fix, and
  the error of its position is the integral. It continues to send its estimated position, so that others avoid it.
- gps_jump: the measured and sent position has an offset. The velocity, measured by Doppler shift, has none.
- cannot_receive: the drone receives no packets.
- link_loss: packets to or from the drone are lost at random, in addition to other losses.
- cannot_transmit: the drone sends no packets. Packets sent before still arrive.
- power_off: the rotors stop, and the drone sends no packets. A point mass falls on a parabola to the ground.

If a fault blocks a packet, the last one received remains valid for `KEPT` s, with its position extrapolated by its
velocity. After that, the drone is no neighbour. A drone reported more than `FALLEN` m below the receiver is not a
neighbour either, so that a falling drone does not pull others down. A drone that loses all of two or more neighbours
assumes that its own radio has failed: it stops and holds until it receives packets again. A drone that never had a
neighbour flies by self-propulsion and walls. A flight without faults has none of these rules, as in the paper.

A fault is active in the control intervals that begin at `at` or later and before `at + duration`. It affects sensing
and policy from the next fix.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.airframe import ROTORS
from controllers.compiling import Off, hot_stage, implements, kernel, stage
from moflock_mj.errors import ScenarioError
from moflock_mj.scenario.faults import KINDS, FaultConfig
from moflock_mj.scenario.scenario import Scenario
from moflock_mj.scenario.schedule import Schedule
from moflock_mj.world.constants import GRAVITY
from moflock_mj.world.state import TrueState

KEPT = 1.0
"""Time for which the last packet of a drone remains valid, s."""

FALLEN = 5.0
"""Height difference beyond which a lower drone is not a neighbour, m."""

NEVER = 2**62
"""End interval of a fault that does not end."""

_ROTOR_FAILURE, _GPS_LOSS, _GPS_JUMP, _CANNOT_RECEIVE, _LINK_LOSS, _CANNOT_TRANSMIT, _POWER_OFF = range(len(KINDS))


class FaultState(NamedTuple):
    """State of faults between fixes, for N drones.

    Attributes:
        position_error: (2, 2, N), GPS position error at the previous fix, m; see `SensorState`.
        velocity_error: (2, 2, N), GPS velocity error at the previous fix, m/s.
        sent: (H, N), 1 for each stored state that was sent as a packet.
        height: (H, N), height in the packet, m.
        age: (N, N), fixes since i last received j: `kept` + 1 if too old, `kept` + 2 if never received while in range.
        cut_off: (N,), 1 for a drone that has lost all neighbours, and holds.
        left_position: (3, N), position at power_off, m.
        left_velocity: (3, N), velocity at power_off, m/s.
    """

    position_error: NDArray[np.float64]
    velocity_error: NDArray[np.float64]
    sent: NDArray[np.uint8]
    height: NDArray[np.float64]
    age: NDArray[np.int64]
    cut_off: NDArray[np.uint8]
    left_position: NDArray[np.float64]
    left_velocity: NDArray[np.float64]


class FaultSchedule(NamedTuple):
    """Schedule of F faults, and their effect on N drones in the present control interval.

    Attributes:
        kind: (F,), numbers in the order of `KINDS`.
        drone: (F,), number of the affected drone, -1 for all.
        first: (F,), first interval of the fault.
        end: (F,), first interval after the fault.
        figure: (F, 2), rotor and effectiveness, jump (m), or fraction of lost packets.
        period: control interval, s.
        kept: fixes for which a last packet remains valid.
        ballistic: True if drones without power fall by `ballistic_fall` instead of their own dynamics.
        without_fix: (N,), time since the loss of GPS, s; -1 with GPS.
        jump: (2, N), offset of the GPS position, m.
        cannot_receive: (N,), 1 for a drone that receives no packets.
        cannot_transmit: (N,), 1 for a drone that sends no packets.
        loss: (N,), fraction of packets lost, in each direction.
        effectiveness: (N, 4), fraction of the commanded thrust of each rotor.
        stopped: (N, 4), 1 for a stopped rotor.
        off_intervals: (N,), intervals since power_off; -1 with power.
        delivered: (N, 4), buffer for the actual thrust of the rotors, N.
        memory: state of the faults, which the schedule does not determine.
    """

    kind: NDArray[np.int64]
    drone: NDArray[np.int64]
    first: NDArray[np.int64]
    end: NDArray[np.int64]
    figure: NDArray[np.float64]
    period: float
    kept: int
    ballistic: bool
    without_fix: NDArray[np.float64]
    jump: NDArray[np.float64]
    cannot_receive: NDArray[np.uint8]
    cannot_transmit: NDArray[np.uint8]
    loss: NDArray[np.float64]
    effectiveness: NDArray[np.float64]
    stopped: NDArray[np.uint8]
    off_intervals: NDArray[np.int64]
    delivered: NDArray[np.float64]
    memory: FaultState


def make_fault_schedule(scenario: Scenario, dynamics: str, step: float, schedule: Schedule) -> FaultSchedule | Off:
    """Create the fault schedule of a scenario.

    Raises:
        ScenarioError: a rotor_failure of a point mass.
    """
    faults, drones, period = scenario.faults, scenario.drones, schedule.steps_per_interval * step
    if not faults:
        return Off()
    for place, fault in enumerate(faults):
        if fault.kind == "rotor_failure" and dynamics == "point_mass":
            raise ScenarioError(f"faults[{place}].kind: rotor_failure needs rigid bodies: a point mass has no rotors")
    intervals = [intervals_of(fault, period) for fault in faults]
    kept = round(KEPT / scenario.t_gps)
    moments = schedule.ticks_late + 1 + kept
    return FaultSchedule(
        kind=np.array([list(KINDS).index(fault.kind) for fault in faults]),
        drone=np.array([-1 if fault.drone is None else fault.drone for fault in faults]),
        first=np.array([first for first, _ in intervals]),
        end=np.array([end for _, end in intervals]),
        figure=np.array([_figure(fault) for fault in faults], np.float64),
        period=period,
        kept=kept,
        ballistic=dynamics == "point_mass",
        without_fix=np.full(drones, -1.0),
        jump=np.zeros((2, drones)),
        cannot_receive=np.zeros(drones, np.uint8),
        cannot_transmit=np.zeros(drones, np.uint8),
        loss=np.zeros(drones),
        effectiveness=np.ones((drones, ROTORS)),
        stopped=np.zeros((drones, ROTORS), np.uint8),
        off_intervals=np.full(drones, -1),
        delivered=np.zeros((drones, ROTORS)),
        memory=FaultState(
            position_error=np.zeros((2, 2, drones)),
            velocity_error=np.zeros((2, 2, drones)),
            sent=np.ones((moments, drones), np.uint8),
            height=np.full((moments, drones), scenario.altitude),
            age=np.full((drones, drones), kept + 2),
            cut_off=np.zeros(drones, np.uint8),
            left_position=np.zeros((3, drones)),
            left_velocity=np.zeros((3, drones)),
        ),
    )


def intervals_of(fault: FaultConfig, period: float) -> tuple[int, int]:
    """First interval of a fault and first interval after it, for intervals of `period` s."""
    first = math.ceil(fault.at / period - 1e-6)
    end = NEVER if fault.duration is None else math.ceil((fault.at + fault.duration) / period - 1e-6)
    return first, end


def _figure(fault: FaultConfig) -> tuple[float, float]:
    if fault.jump is not None:
        return fault.jump
    if fault.rotor is not None and fault.effectiveness is not None:
        return float(fault.rotor), fault.effectiveness
    return fault.share or 0.0, 0.0


@stage
def apply_faults(faults: NamedTuple, world: TrueState, interval: int) -> None:
    """Update the active faults at the start of an interval; no effect without faults.

    Args:
        faults: the fault schedule; updated.
        world: the true state.
        interval: number of the interval.
    """


@stage
def hold_without_gps_or_link(faults: NamedTuple, desired: NDArray[np.float64]) -> None:
    """Command zero velocity to drones without GPS or without a link; no effect without faults.

    Args:
        faults: the fault schedule.
        desired: (2, N), desired velocities, m/s, world; changed.
    """


@stage
def ballistic_fall(faults: NamedTuple, world: TrueState) -> None:
    """Move point masses without power along their fall to the end of the interval; no effect without faults."""


@hot_stage
def has_fix(faults: NamedTuple, i: int) -> bool:
    """True if drone i has a GPS fix; always without faults."""
    return True


@kernel
def _apply_fault(faults: FaultSchedule, world: TrueState, f: int, age: int, i: int) -> None:
    """Apply fault f, which began `age` intervals ago, to drone i."""
    kind, figure = faults.kind[f], faults.figure
    if kind == _ROTOR_FAILURE:
        faults.effectiveness[i, int(figure[f, 0])] *= figure[f, 1]
    elif kind == _GPS_LOSS:
        faults.without_fix[i] = max(faults.without_fix[i], age * faults.period)
    elif kind == _GPS_JUMP:
        faults.jump[0, i] += figure[f, 0]
        faults.jump[1, i] += figure[f, 1]
    elif kind == _CANNOT_RECEIVE:
        faults.cannot_receive[i] = 1
    elif kind == _LINK_LOSS:
        faults.loss[i] = 1 - (1 - faults.loss[i]) * (1 - figure[f, 0])
    elif kind == _CANNOT_TRANSMIT:
        faults.cannot_transmit[i] = 1
    elif kind == _POWER_OFF:
        faults.cannot_transmit[i] = 1
        for rotor in range(ROTORS):
            faults.stopped[i, rotor] = 1
        faults.off_intervals[i] = max(faults.off_intervals[i], age)
        if faults.off_intervals[i] == 0:
            for axis in range(3):
                faults.memory.left_position[axis, i] = world.position[axis, i]
                faults.memory.left_velocity[axis, i] = world.velocity[axis, i]


@implements(apply_faults, FaultSchedule)
def apply_fault_schedule(faults: FaultSchedule, world: TrueState, interval: int) -> None:
    faults.without_fix[:] = -1
    faults.jump[:] = 0
    faults.cannot_receive[:] = 0
    faults.cannot_transmit[:] = 0
    faults.loss[:] = 0
    faults.effectiveness[:] = 1
    faults.stopped[:] = 0
    faults.off_intervals[:] = -1
    for f in range(faults.kind.size):
        if not faults.first[f] <= interval < faults.end[f]:
            continue
        affected, age = faults.drone[f], interval - faults.first[f]
        for i in range(faults.cannot_receive.size):
            if affected < 0 or i == affected:
                _apply_fault(faults, world, f, age, i)


@implements(hold_without_gps_or_link, FaultSchedule)
def _hold_without_gps_or_link(faults: FaultSchedule, desired: NDArray[np.float64]) -> None:
    for i in range(desired.shape[1]):
        if faults.without_fix[i] >= 0 or faults.memory.cut_off[i]:
            desired[0, i] = desired[1, i] = 0.0


@implements(ballistic_fall, FaultSchedule)
def _fall(faults: FaultSchedule, world: TrueState) -> None:
    """Ballistic fall from the position and velocity at power_off: x = x0 + v0 t, z = z0 - g t^2 / 2, to the ground."""
    if not faults.ballistic:
        return
    left, velocity = faults.memory.left_position, faults.memory.left_velocity
    for i in range(faults.cannot_receive.size):
        if faults.off_intervals[i] < 0:
            continue
        time, landing = (faults.off_intervals[i] + 1) * faults.period, math.sqrt(2 * left[2, i] / GRAVITY)
        down = time >= landing
        time = min(time, landing)
        for axis in range(2):
            world.position[axis, i] = left[axis, i] + velocity[axis, i] * time
            world.velocity[axis, i] = 0.0 if down else velocity[axis, i]
        world.position[2, i] = 0.0 if down else left[2, i] - GRAVITY / 2 * time * time
        world.velocity[2, i] = 0.0 if down else -GRAVITY * time
        if down:
            world.touched[i] = 1


@implements(has_fix, FaultSchedule)
def _has_fix(faults: FaultSchedule, i: int) -> bool:
    return bool(faults.without_fix[i] < 0)
