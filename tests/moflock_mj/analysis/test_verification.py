"""Logged flights flown again: bit by bit the same, or the place where they differ; and flights resumed from logs."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from moflock_mj import LoggedFlight, Scenario, fly, load_point, read_log
from moflock_mj.analysis.target_tracking import track_target
from moflock_mj.analysis.verification import Difference, resume, verify
from moflock_mj.errors import LogError, MoflockError
from moflock_mj.log.schemas import Metrics
from tests.support.logs import rebuild

A, B = load_point("A"), load_point("B")
SCENARIO = Scenario(drones=4, arena_side=80.0, duration=23.0, packet_loss_ratio=0.5)


@pytest.fixture(scope="module", params=["point_mass", "rigid_body"])
def log(request, tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "a.mcap"
    fly(A, scenario=SCENARIO, dynamics=request.param, seed=5, log=path, keep_samples=False)
    return path


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "quick.mcap"
    fly(A, scenario=SCENARIO, dynamics="point_mass", seed=5, log=path, keep_samples=False)
    return path


def test_a_flight_comes_out_again_bit_by_bit(log):
    told = []
    verification = verify(read_log(log), progress=lambda t, fitness: told.append((t, fitness)))
    assert verification.identical
    assert verification.difference is None
    assert (verification.ticks, verification.start, verification.time) == (231, 0.0, 23.0)
    assert verification.changes == ()
    assert [t for t, _ in told] == pytest.approx([10.0, 20.0, 23.0])
    assert told[-1][1] == read_log(log).fitness


@pytest.mark.parametrize("dynamics", ["point_mass", "rigid_body"])
def test_an_interrupted_flight_is_verified_as_far_as_it_came(tmp_path, dynamics):
    told = []
    path = tmp_path / "a.mcap"
    fly(
        A,
        scenario=SCENARIO,
        dynamics=dynamics,
        log=path,
        progress=lambda t, _: told.append(t),
        stop=lambda: len(told) == 3,
    )
    verification = verify(read_log(path))
    assert verification.identical
    assert (verification.ticks, verification.time, verification.duration) == (31, 3.0, 23.0)


def spoil_digest(when):
    def change(topic, time_ns, data):
        if topic == "/metrics" and time_ns == when:
            metrics = Metrics.FromString(data)
            digest = bytes(byte ^ 1 for byte in metrics.state_digest)
            data = data.replace(metrics.state_digest, digest)
        return topic, time_ns, data

    return change


def spoil_point(when, drone, drones=4, point_size=68):
    def change(topic, time_ns, data):
        if topic == "/swarm/points" and time_ns == when:
            content = bytearray(data)
            # The points are the message's last field.
            content[len(data) - (drones - drone) * point_size] ^= 1
            data = bytes(content)
        return topic, time_ns, data

    return change


def test_a_changed_digest_is_found(quick, tmp_path):
    verification = verify(read_log(rebuild(quick, tmp_path / "a.mcap", change=spoil_digest(11_700_000_000))))
    assert not verification.identical
    assert verification.difference == Difference(117, 11.7, None, "state")
    assert verification.ticks == 118


@pytest.mark.parametrize("drone", [0, 2, 3])
def test_a_changed_point_is_found_with_its_drone(quick, tmp_path, drone):
    verification = verify(read_log(rebuild(quick, tmp_path / "a.mcap", change=spoil_point(20_000_000_000, drone))))
    assert verification.difference == Difference(200, 20.0, drone, "points")


def test_changed_figures_are_found(quick, tmp_path):
    def change(topic, time_ns, data):
        if topic == "/metrics" and time_ns == 500_000_000:
            data = data[:1] + bytes([data[1] ^ 1]) + data[2:]
        return topic, time_ns, data

    verification = verify(read_log(rebuild(quick, tmp_path / "a.mcap", change=change)))
    assert verification.difference == Difference(5, 0.5, None, "order parameters")


@pytest.mark.parametrize("run", [{"seed": "6"}, {"dynamics": "rigid_body"}])
def test_another_flight_is_found_at_once(quick, tmp_path, run):
    verification = verify(read_log(rebuild(quick, tmp_path / "a.mcap", run=run)))
    assert verification.difference.tick <= 1
    assert verification.difference.drone is not None


def test_other_versions_are_listed(quick, tmp_path):
    run = {"mujoco_version": "3.4.5", "cpu": "abacus", "commit": None}
    verification = verify(read_log(rebuild(quick, tmp_path / "a.mcap", run=run)))
    assert verification.identical
    assert [change.name for change in verification.changes][:2] == ["MuJoCo", "processor"]
    assert verification.changes[0].logged == "3.4.5"


def test_a_resumed_flight_is_the_original(log, tmp_path):
    original: LoggedFlight = read_log(log)
    flight = resume(read_log(log), 19.9, log=tmp_path / "b.mcap")
    resumed = read_log(tmp_path / "b.mcap")
    assert flight.complete
    assert resumed.start == 10.0
    assert resumed.metadata["resumed_from"] == "a.mcap"
    assert resumed.missing == 0
    assert sorted(resumed.states) == [10.0, 20.0]
    assert resumed.states[20.0] == original.states[20.0]
    np.testing.assert_array_equal(flight.samples.t, original.samples.t[101:])
    np.testing.assert_array_equal(resumed.samples.t, original.samples.t[101:])
    np.testing.assert_array_equal(resumed.digests, original.digests[101:])
    assert flight.order_parameters == original.order_parameters
    assert flight.events == tuple(event for event in original.events if event.time_ns > 10e9)
    verification = verify(read_log(tmp_path / "b.mcap"))
    assert verification.identical
    assert (verification.ticks, verification.start) == (130, 10.0)


def test_a_resumed_flight_is_resumed_again(log, tmp_path):
    resume(read_log(log), 10.0, log=tmp_path / "b.mcap")
    resume(read_log(tmp_path / "b.mcap"), 23.0, log=tmp_path / "c.mcap")
    np.testing.assert_array_equal(read_log(tmp_path / "c.mcap").digests, read_log(log).digests[201:])


def test_a_flight_can_go_on_beyond_its_end(quick):
    longer = fly(A, scenario=SCENARIO.replace(duration=31.0), dynamics="point_mass", seed=5)
    flight = resume(read_log(quick), 20.0, duration=11.0)
    assert flight.flown == 31.0
    np.testing.assert_array_equal(flight.samples.position, longer.samples.position[201:])
    assert flight.order_parameters == longer.order_parameters
    assert resume(read_log(quick), 20.0, duration=1.0).flown == 21.0


def test_with_other_parameters_it_is_another_flight(quick, tmp_path):
    switched = resume(read_log(quick), 10.0, params=B, duration=20.0, log=tmp_path / "b.mcap")
    kept = resume(read_log(quick), 10.0, duration=20.0)
    assert switched.params == B
    np.testing.assert_allclose(switched.samples.position[0], kept.samples.position[0], rtol=0, atol=0.1)
    assert not np.array_equal(switched.samples.position[-1], kept.samples.position[-1])
    assert read_log(tmp_path / "b.mcap").params == B
    assert verify(read_log(tmp_path / "b.mcap")).identical


def test_a_state_between_two_decisions_is_enough(tmp_path):
    path = tmp_path / "odd.mcap"
    scenario = SCENARIO.replace(t_gps=0.7, t_del=0.9, sample_period=0.4, duration=24.0)
    fly(A, scenario=scenario, dynamics="point_mass", log=path)
    original, flight = read_log(path), resume(read_log(path), 15.0)
    np.testing.assert_array_equal(
        flight.samples.position.astype(np.float32), original.samples.position[-len(flight.samples.t) :]
    )


@pytest.mark.parametrize(
    ("at", "keywords", "words"),
    [
        (23.5, {}, "resume: 23.5 s is out of bounds: the log .* ends at 23 s"),
        (-1.0, {}, "resume: -1 s is out of bounds"),
        (math.nan, {}, "resume: nan s is out of bounds"),
        (10.0, {"duration": 0.0}, "duration: 0 s is out of bounds"),
        (10.0, {"duration": math.inf}, "duration: inf s is out of bounds"),
        (10.0, {"duration": 0.05}, "duration: 10.05 s must be a whole multiple"),
        (10.0, {"params": A[:5]}, "holds the parameters of no policy"),
    ],
)
def test_what_cannot_be_resumed_is_refused(quick, at, keywords, words):
    with pytest.raises(MoflockError, match=words) as refusal:
        resume(read_log(quick), at, **keywords)
    assert "\n" not in str(refusal.value)


def test_a_flight_around_a_target_is_read_verified_and_resumed(tmp_path):
    path, target = tmp_path / "a.mcap", (30.0, -20.0)
    tracked = track_target(A, target=target, scenario=SCENARIO, transient=10.0, log=path)
    logged = read_log(path)
    assert logged.params == tracked.flight.params == (A, *target)
    assert verify(logged).identical
    np.testing.assert_array_equal(resume(logged, 10.0).samples.position, tracked.flight.samples.position[101:])
    resume(logged, 10.0, params=B, log=tmp_path / "b.mcap")
    switched = read_log(tmp_path / "b.mcap")
    assert switched.params == (B, *target)
    assert verify(switched).identical


@pytest.mark.parametrize("x", [1e9, math.nan, None, "far"])
def test_a_target_that_cannot_be_is_refused(quick, tmp_path, x):
    parameters = json.dumps({**A._asdict(), "target_x": x, "target_y": 0.0})
    with pytest.raises(LogError, match=r"target_x|parameters"):
        read_log(rebuild(quick, tmp_path / "a.mcap", run={"policy": "target_tracking", "parameters": parameters}))


def test_a_log_is_not_resumed_into_itself(quick):
    with pytest.raises(LogError, match="is the log that the flight is resumed from"):
        resume(read_log(quick), 10.0, log=quick)


def test_states_that_do_not_belong_are_refused(quick, tmp_path):
    def swap(topic, time_ns, data):
        return (topic, time_ns + 1_000_000_000 * (topic == "/sim/state"), data)

    def cut(topic, time_ns, data):
        return (topic, time_ns, b"" if topic == "/sim/state" else data)

    def drop(topic, time_ns, data):
        return None if topic == "/sim/state" else (topic, time_ns, data)

    for change, words in ((swap, "at 11 s is that of 10 s"), (cut, "not a snapshot"), (drop, "has no state")):
        with pytest.raises(LogError, match=words):
            resume(read_log(rebuild(quick, tmp_path / "a.mcap", change=change)), 12.0)


def test_a_flight_at_its_end_needs_a_duration(tmp_path):
    path = tmp_path / "a.mcap"
    fly(A, scenario=SCENARIO.replace(duration=10.0), dynamics="point_mass", log=path)
    with pytest.raises(LogError, match="ends at 10 s; flying on needs a duration"):
        resume(read_log(path), 10.0)
    assert resume(read_log(path), 10.0, duration=5.0).flown == 15.0
