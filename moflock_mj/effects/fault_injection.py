"""What faults do to a flight: a schedule in whole beats, and the stages at which the loop follows it.

- rotor_failure: the rotor gives a share of the thrust that it is commanded, at the full speed and power of that thrust,
  as with a broken blade: battery and rotor drag do not change. The controllers do not know.
- gps_loss: the drone stops and holds. It goes on by inertial sensors: the error of its velocity stays that of the
  last fix, and that of its position grows by it. It tells what it believes, so that others keep off.
- gps_jump: the position that it reads and tells is off. Its velocity, by Doppler shift, is not.
- cannot_receive: the drone hears nobody.
- link_loss: packets to or from it get lost at random, on top of other losses.
- cannot_transmit: it sends nothing. Packets that are in the air still arrive.
- power_off: rotors stand still, and it sends nothing. A point mass falls on a parabola to the ground, and stays.

Where a fault keeps a packet back, the last one counts for `KEPT` s more, its position carried on by its velocity; after
that the drone is no neighbour. Nor is one a neighbour that tells of a height `FALLEN` m below the hearer's, so that a
falling drone draws nobody along. One that hears nobody any more though two or more were there stops and holds until it
hears again: it takes its own radio for broken. Who never heard anybody flies on by self-propulsion and walls. A flight
without faults has none of this, as in the paper.

A fault acts in the beats that begin at `at` or later and before `at + duration`; on sensing and policy, from the next
tick on.
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
"""s for which the last packet of a drone counts when the next ones do not come."""


FALLEN = 5.0
"""m below a drone from which on it does not heed another."""


NEVER = 2**62
"""The beat in which a fault ends that does not."""


_ROTOR_FAILURE, _GPS_LOSS, _GPS_JUMP, _CANNOT_RECEIVE, _LINK_LOSS, _CANNOT_TRANSMIT, _POWER_OFF = range(len(KINDS))


class FaultState(NamedTuple):
    """What faults carry from tick to tick, of N drones.

    Attributes:
        position_error: (2, 2, N), m, of the GPS at the tick before; see `SensorState`.
        velocity_error: (2, 2, N), m/s.
        sent: (H, N), whether a packet was sent at each moment of the ring of the past.
        height: (H, N), m, that it tells.
        age: (N, N), ticks since i heard j last: `kept` + 1 for too long ago, `kept` + 2 for never while in range.
        cut_off: (N,), 1 for a drone that hears nobody any more, and holds.
        left_position: (3, N), m, where a drone was switched off.
        left_velocity: (3, N), m/s, then.
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
    """The schedule of F faults, and what follows from it for N drones in the present beat.

    Attributes:
        kind: (F,), numbers in the order of `KINDS`.
        drone: (F,), -1 for all.
        first: (F,), the beat in which it begins.
        end: (F,), the first beat in which it is over.
        figure: (F, 2), rotor and effectiveness, jump (m), or share of packets.
        period: s, of a beat.
        kept: ticks for which a last packet counts.
        ballistic: whether drones that are switched off fall by `ballistic_fall`, not by their own dynamics.
        without_fix: (N,), s since an outage began, -1 with GPS.
        jump: (2, N), m.
        cannot_receive: (N,), 1 for a drone that hears nobody.
        cannot_transmit: (N,), 1 for one that sends nothing.
        loss: (N,), share of its packets that get lost, each way.
        effectiveness: (N, 4), of the rotors.
        stopped: (N, 4), 1 for a rotor that stands still.
        off_intervals: (N,), beats since it was switched off, -1 while it is not.
        delivered: (N, 4), N, room for the thrust of the rotors.
        memory: changes in flight, and is not told by the schedule.
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
    """The faults of a scenario, before the first of them.

    Raises:
        ScenarioError: a rotor of a point mass.
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
    """The first beat in which a fault acts and the first in which it is over; beats begin each `period` s."""
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
    """Let faults begin and end with a beat. world: the true state."""


@stage
def hold_without_gps_or_link(faults: NamedTuple, desired: NDArray[np.float64]) -> None:
    """Let drones without GPS, or cut off, want to stand, desired: (2, N), m/s."""


@stage
def ballistic_fall(faults: NamedTuple, world: TrueState) -> None:
    """Put point masses that are switched off where they have fallen by the end of the beat."""


@hot_stage
def has_fix(faults: NamedTuple, i: int) -> bool:
    """Whether drone i has GPS."""
    return True


@kernel
def _apply_fault(faults: FaultSchedule, world: TrueState, f: int, age: int, i: int) -> None:
    """Let fault f, which began `age` beats ago, act on drone i."""
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
        only, age = faults.drone[f], interval - faults.first[f]
        for i in range(faults.cannot_receive.size):
            if only < 0 or i == only:
                _apply_fault(faults, world, f, age, i)


@implements(hold_without_gps_or_link, FaultSchedule)
def _hold_without_gps_or_link(faults: FaultSchedule, desired: NDArray[np.float64]) -> None:
    for i in range(desired.shape[1]):
        if faults.without_fix[i] >= 0 or faults.memory.cut_off[i]:
            desired[0, i] = desired[1, i] = 0.0


@implements(ballistic_fall, FaultSchedule)
def _fall(faults: FaultSchedule, world: TrueState) -> None:
    """X = x0 + v0 t, z = z0 - g t^2 / 2 until the ground, where it stays."""
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
