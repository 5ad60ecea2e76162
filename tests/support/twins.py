"""Reference implementations of compiled code in plain Python, one drone and one pair at a time."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from controllers.policies.vasarhelyi import VasarhelyiParams
from moflock_mj.scenario.effect_configs import PointMassConfig
from moflock_mj.scenario.scenario import Scenario
from moflock_mj.simulation.initial_state import make_initial_state
from moflock_mj.simulation.random_numbers import RandomStreams


def braking_curve(x, a, p):
    if x * p <= 0:
        return 0.0
    if x < a / p / p:
        return x * p
    return math.sqrt(2 * a * x - (a / p) ** 2)


def braking_distance(v, a, p):
    return v / p if v < a / p else (v**2 / a + a / p**2) / 2


def desired_velocity(params: VasarhelyiParams, scenario: Scenario, own, own_velocity, neighbours):
    """Desired velocity of one drone, m/s; neighbours: pairs of received position and velocity."""
    p = params
    total = np.zeros(2)
    speed = np.linalg.norm(own_velocity)
    if speed > 0:
        total += scenario.v_flock * own_velocity / speed
    for position, velocity in neighbours:
        r, v = position - own, velocity - own_velocity
        distance, difference = np.linalg.norm(r), np.linalg.norm(v)
        if 0 < distance < p.r0_rep:
            total -= min(p.p_rep * (p.r0_rep - distance), scenario.v_rep_max) * r / distance
        m = max(p.v_frict, braking_curve(distance - p.r0_frict - p.r0_rep, p.a_frict, p.p_frict))
        if difference > m:
            total += p.c_frict * (difference - m) * v / difference
    for axis in range(2):
        shill = np.zeros(2)
        shill[axis] = -p.v_shill * np.sign(own[axis])
        e = shill - own_velocity
        m = braking_curve(scenario.arena_side / 2 - abs(own[axis]) - p.r0_shill, p.a_shill, p.p_shill)
        if np.linalg.norm(e) > m:
            total += p.c_shill * (np.linalg.norm(e) - m) * e / np.linalg.norm(e)
    length = np.linalg.norm(total)
    return total * min(1.0, scenario.v_max / length) if length > 0 else total


@dataclass
class GpsErrors:
    """GPS errors of N drones: position error g, m, and velocity error h, m/s, each (N, 2)."""

    g: np.ndarray
    h: np.ndarray

    def drift(self, scenario: Scenario, xi):
        lam, t = scenario.lambda_gps, scenario.t_gps
        strength = math.sqrt(2 * lam * scenario.sigma_inner)
        self.h = self.h + strength * t * xi / math.sqrt(t) - lam * t * self.h - strength / 3 * t * self.g
        self.g = self.g + t * self.h


def acting(scenario: Scenario, kind, i, time):
    """Faults of a kind that affect drone i at a time."""
    return [
        fault
        for fault in scenario.faults
        if fault.kind == kind
        and fault.drone in (None, i)
        and fault.at - 1e-9 <= time < fault.at + (fault.duration or math.inf) - 1e-9
    ]


@dataclass
class SlowFlight:
    """Point-mass flight, step by step, with the same random numbers as the compiled one."""

    params: VasarhelyiParams
    scenario: Scenario
    seed: int
    samples: list = field(default_factory=list)
    last: dict = field(default_factory=dict)
    cut_off: set = field(default_factory=set)

    def fly(self):
        scenario, n = self.scenario, self.scenario.drones
        step = scenario.step_for("point_mass")
        streams = RandomStreams.of(self.seed)
        world = make_initial_state(scenario, streams.start)
        x, v = world.position.T.copy(), world.velocity.T.copy()
        states = [(x.copy(), v.copy())]
        first, packets = list(zip(x, v, strict=True)), []
        own, sent = (GpsErrors(np.zeros((n, 2)), np.zeros((n, 2))) for _ in range(2))
        desired, left = np.zeros((n, 2)), {}
        delay, fix = round(scenario.t_del / step), round(scenario.t_gps / step)
        steps = round(scenario.duration / step)
        response = scenario.point_mass or PointMassConfig(tau=scenario.tau, a_max=scenario.a_max)
        commands = []
        for k in range(steps):
            time = k * step
            packets.append([self._packet(i, time, x[i], v[i]) for i in range(n)])
            if k % fix == 0:
                xi = streams.sensing.standard_normal((2, 2, n))
                for error, draws in ((own, xi[0].T), (sent, xi[1].T)):
                    self._drift(error, time, draws)
                lost = streams.faults.random((n, n)) if "link_loss" in str(scenario.faults) else np.ones((n, n))
                received = packets[k - delay] if k >= delay else first
                desired = np.array([self._decide(i, time, x, v, own, sent, received, lost[i]) for i in range(n)])
            xi = streams.disturbance.standard_normal((2, n)).T
            commands.append(desired - v[:, :2] - own.h)
            wanted = self._late(commands, response.delay, step) / response.tau
            size = np.linalg.norm(wanted, axis=1, keepdims=True)
            clipped = wanted * np.minimum(1, response.a_max / np.maximum(size, 1e-300))
            for i in range(n):
                for fault in acting(scenario, "power_off", i, time):
                    left.setdefault(i, (fault.at, x[i].copy(), v[i].copy()))
            x = x + step * v
            v = v + 0.0
            v[:, :2] += step * clipped + math.sqrt(2 * scenario.sigma_outer * step) * xi
            for i, (since, place, velocity) in left.items():
                x[i], v[i] = fallen(place, velocity, time + step - since)
            states.append((x.copy(), v.copy()))
        every = round(scenario.sample_period / step)
        self.samples = states[::every]
        return self

    def _late(self, commands, delay, step):
        """Command at `delay` before the middle of the latest step, interpolated; zero before the first command."""
        back = max(delay / step - 0.5, 0)
        newer, older = (len(commands) - 1 - math.floor(back) - k for k in (0, 1))
        share = back - math.floor(back)
        held = [commands[k] if k >= 0 else 0 * commands[0] for k in (newer, older)]
        return (1 - share) * held[0] + share * held[1]

    def _drift(self, error, time, xi):
        g, h = error.g.copy(), error.h.copy()
        error.drift(self.scenario, xi)
        for i in range(len(g)):
            if acting(self.scenario, "gps_loss", i, time):
                error.h[i] = h[i]
                error.g[i] = g[i] + self.scenario.t_gps * h[i]

    def _packet(self, i, time, x, v):
        """Packet of drone i, (position, velocity), or None."""
        if acting(self.scenario, "cannot_transmit", i, time) or acting(self.scenario, "power_off", i, time):
            return None
        return x + np.append(self._jump(i, time), 0), v.copy()

    def _jump(self, i, time):
        return sum((np.array(fault.jump) for fault in acting(self.scenario, "gps_jump", i, time)), np.zeros(2))

    def _decide(self, i, time, x, v, own, sent, packets, draws):
        scenario, receives, arrived, missing = self.scenario, [], False, 0
        for j, packet in enumerate(packets):
            if j == i or np.linalg.norm(x[j] - x[i]) >= scenario.r_comm:
                self.last.pop((i, j), None)
                continue
            arrives = packet is not None and not acting(scenario, "cannot_receive", i, time)
            for share in (self._share(i, time), self._share(j, time)):
                arrives = arrives and draws[j] >= share
            if arrives:
                self.last[i, j], arrived = (time, *packet), True
            if (i, j) not in self.last:
                continue
            since, place, velocity = self.last[i, j]
            if time - since > 1.0 + 1e-9:
                missing += 1
            elif place[2] > x[i, 2] - 5:
                extrapolated = place[:2] + (time - since) * velocity[:2]
                receives.append((extrapolated + sent.g[j], velocity[:2] + sent.h[j]))
        if arrived:
            self.cut_off.discard(i)
        elif not receives and missing >= 2:
            self.cut_off.add(i)
        if acting(scenario, "gps_loss", i, time) or i in self.cut_off:
            return np.zeros(2)
        reads = x[i, :2] + own.g[i] + self._jump(i, time)
        return desired_velocity(self.params, scenario, reads, v[i, :2] + own.h[i], receives)

    def _share(self, i, time):
        kept = [1 - fault.share for fault in acting(self.scenario, "link_loss", i, time)]
        return 1 - math.prod(kept)


def fallen(place, velocity, time):
    """Position and velocity of a body in ballistic fall from `place` with a horizontal velocity, until the ground."""
    landing = math.sqrt(2 * place[2] / 9.81)
    moved = place + velocity * min(time, landing)
    if time >= landing:
        return np.array([moved[0], moved[1], 0.0]), np.zeros(3)
    return moved - [0, 0, 9.81 * time**2 / 2], velocity - [0, 0, 9.81 * time]


def order_parameters(positions, velocities, params: VasarhelyiParams, scenario: Scenario):
    """Order parameters (wall, vel, corr, coll, disc, cluster) of positions and velocities (T, N, 2 or 3)."""
    r_cluster = params.r0_rep + params.r0_frict
    r_cluster += braking_distance(scenario.v_flock, params.a_frict, params.p_frict)
    n = positions.shape[1]
    wall, vel, corr, coll, disc, cluster = [], [], [], [], [], []
    for x, v in zip(positions, velocities, strict=True):
        beyond = np.max(np.abs(x[:, :2]), axis=1) - scenario.arena_side / 2
        wall += [b for b in beyond if b > 0]
        vel.append(np.mean(np.linalg.norm(v, axis=1)))
        counts, correlations, close = [], [], 0
        for i in range(n):
            cosines = []
            for j in range(n):
                distance = np.linalg.norm(x[j] - x[i])
                if j != i and distance < scenario.r_coll:
                    close += 1
                if j != i and distance < r_cluster:
                    speeds = np.linalg.norm(v[i]) * np.linalg.norm(v[j])
                    cosines.append(v[i] @ v[j] / speeds if speeds > 0 else 0.0)
            counts.append(len(cosines))
            correlations.append(np.mean(cosines) if cosines else 0.0)
        corr.append(np.mean(correlations))
        coll.append(close / (n * (n - 1)) if n > 1 else 0.0)
        disc.append(counts.count(0))
        cluster.append(min(counts))
    return [float(np.mean(values)) if values else 0.0 for values in (wall, vel, corr, coll, disc, cluster)]


def dryden_correlation(lateral, lag, scale_time):
    """Correlation of gusts along the wind, or across and up (lateral): Fourier transform of the Dryden spectrum."""
    ratio = lag / scale_time
    return math.exp(-ratio) * (1 - ratio / 2 if lateral else 1)


def next_gusts(gusts, wind, velocities, draws):
    """Air velocity (N, 3) after one period from the states (u, p_v, q_v, p_w, q_w); updates `gusts` (N, 5)."""
    air = []
    for i, (state, velocity, xi) in enumerate(zip(gusts, velocities, draws, strict=True)):
        airspeed = max(np.linalg.norm(velocity - wind.velocity[:, i]), 1.0)
        ratio = airspeed * wind.period / wind.length_u
        state[0] = math.exp(-ratio) * state[0] + math.sqrt(1 - math.exp(-2 * ratio)) * xi[0]
        for first, length in ((1, wind.length_u), (3, wind.length_w)):
            ratio = airspeed * wind.period / length
            transition = math.exp(-ratio) * np.array([[1, 0], [ratio, 1]])
            stationary = np.array([[2, 1], [1, 1]]) / 4
            gathered = np.linalg.cholesky(stationary - transition @ stationary @ transition.T)
            state[first : first + 2] = transition @ state[first : first + 2] + gathered @ xi[first : first + 2]
        u, v, w = state[0], *(math.sqrt(3) * state[k] + (1 - math.sqrt(3)) * state[k + 1] for k in (1, 3))
        along = np.append(wind.along, 0)
        across = np.array([-wind.along[1], wind.along[0], 0])
        air.append(
            np.append(wind.speed * wind.along, 0)
            + wind.sigma_u * (u * along + v * across)
            + wind.sigma_w * w * np.eye(3)[2]
        )
    return np.array(air)


def drag_force(body, rotors, weight, rotation, airspeed, thrust):
    """Drag on one drone, N, world: of the body (kg/m), and of the rotors (kg/s in hover) in their plane."""
    axis = rotation[:, 2]
    in_plane = airspeed - (airspeed @ axis) * axis
    return -body * np.linalg.norm(airspeed) * airspeed - rotors * math.sqrt(thrust / weight) * in_plane


def jet_speed(thrust, fastest, below, beside):
    """Air speed in the downwash of a hovering drone, m/s."""
    axis = min(5.8 * math.sqrt(4 * thrust / (math.pi * 1.225)) / below, fastest)
    return axis / (1 + (math.sqrt(2) - 1) * (beside / below / 0.094) ** 2) ** 2


def wash_forces(downwash, positions):
    """Downwash forces (N,), N, downwards."""
    forces = np.zeros(len(positions))
    for i, lower in enumerate(positions):
        for upper in positions:
            below, beside = upper[2] - lower[2], math.hypot(*(upper - lower)[:2])
            if below > 0 and beside < 0.5 * below:
                forces[i] += downwash.drag * jet_speed(downwash.thrust, downwash.fastest, below, beside) ** 2
    return forces


def battery_under_load(open_circuit, resistance, power):
    """Voltage and current at a power, by fixed-point iteration."""
    voltage = open_circuit
    for _ in range(200):
        voltage = open_circuit - resistance * power / voltage
    return voltage, power / voltage


@dataclass
class Navigator:
    """State estimator of one drone, with vectors and matrices."""

    gains: object
    step: float
    rotation: np.ndarray
    velocity: np.ndarray
    height: float
    rates: np.ndarray = field(default_factory=lambda: np.zeros(3))
    rate_bias: np.ndarray = field(default_factory=lambda: np.zeros(3))
    lift_bias: float = 0.0

    def integrate(self, rates, force):
        self.rates = rates - self.rate_bias
        self.rotation = self.rotation @ rotation_by(self.step * self.rates)
        acceleration = self.rotation @ force - (0, 0, 9.81 + self.lift_bias)
        self.velocity = self.velocity + self.step * acceleration
        self.height += self.step * self.velocity[2]

    def correct(self, velocity, height, heading):
        off = np.append(velocity - self.velocity[:2], height - self.height)
        turn = heading - math.atan2(self.rotation[1, 0], self.rotation[0, 0])
        turn = math.atan2(math.sin(turn), math.cos(turn))
        g, before = self.gains, self.rotation
        self.velocity = self.velocity + np.array([g.velocity, g.velocity, g.climb]) * off
        self.height += g.height * off[2]
        self.lift_bias += g.lift_bias * off[2]
        self.rotation = rotation_by(np.array([-g.tilt * off[1], g.tilt * off[0], g.heading * turn])) @ before
        bias = np.array([-g.tilt_bias * off[1], g.tilt_bias * off[0], g.heading_bias * turn])
        self.rate_bias = self.rate_bias + before.T @ bias


def rotation_by(turn):
    """Rotation matrix of a rotation vector, rad (Rodrigues)."""
    angle = np.linalg.norm(turn)
    if angle == 0:
        return np.eye(3)
    x, y, z = turn / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross


def quaternion_matrix(q):
    """Rotation matrix, body to world, of a quaternion w x y z."""
    w, *v = q
    x, y, z = v
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + 2 * w * cross + 2 * cross @ cross


def point_mass_in_wind(state, observer, desired, air, figures, step):
    """Position, velocity and observer of one drone (2,) after one step.

    The figures are tau (s), a_max (m/s^2), drag of body (1/m) and rotors (1/s), bandwidth of the observer (rad/s), and
    bound of the disturbance (m/s^2).
    """
    (x, v), (predicted, disturbance) = state, observer
    tau, a_max, body, rotors, bandwidth, bound = figures
    wanted = (desired - v) / tau
    wanted = wanted * min(1, a_max / max(np.linalg.norm(wanted), 1e-300))
    against = air - v
    pushed = (body * np.linalg.norm(against) + rotors) * against
    innovation, own = v - predicted, wanted - disturbance
    predicted = predicted + step * (own + disturbance + 2 * bandwidth * innovation)
    next_disturbance = np.clip(disturbance + step * bandwidth**2 * innovation, -bound, bound)
    return (x + step * v, v + step * (own + pushed)), (predicted, next_disturbance)
