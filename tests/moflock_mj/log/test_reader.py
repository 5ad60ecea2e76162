"""Logs read back: the same flight, quickly, and one clear line for every file that is none."""

from __future__ import annotations

import json
import time
from pathlib import Path

import numpy as np
import pytest

from moflock_mj import LoggedFlight, Scenario, fly, load_point, read_log
from moflock_mj.errors import LogError
from moflock_mj.log.schemas import RUN_COPY, Metrics, state_digests
from moflock_mj.metrics.order_parameters import CLOSE, OUTSIDE
from moflock_mj.simulation.simulation import Simulation
from tests.support.logs import bomb, flipped, foreign, rebuild

A = load_point("A")
# Small enough that drones leave the arena and meet.
CROWDED = Scenario(drones=8, arena_side=30.0, duration=12.0, start_spacing=2.0)


@pytest.fixture(scope="module", params=["point_mass", "rigid_body"])
def pair(request, tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "a.mcap"
    flight = fly(A, scenario=CROWDED, dynamics=request.param, seed=3, log=path)
    return flight, read_log(path)


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "good.mcap"
    fly(A, scenario=Scenario(drones=3, arena_side=60.0, duration=3.0), dynamics="point_mass", log=path)
    return path


def test_a_log_is_the_flight(pair):
    flight, logged = pair
    for name in ("params", "scenario", "dynamics", "seed", "flown", "order_parameters", "fitness", "events", "log"):
        assert getattr(logged, name) == getattr(flight, name), name
    assert logged.complete
    assert logged.start == logged.missing == 0
    np.testing.assert_array_equal(logged.samples.t, flight.samples.t)
    for name in ("position", "velocity", "desired_velocity"):
        expected = getattr(flight.samples, name)
        np.testing.assert_array_equal(getattr(logged.samples, name), expected.astype(np.float32), strict=False)
        assert getattr(logged.samples, name).dtype == np.float64
    for name, running in flight.samples.order_parameters._asdict().items():
        np.testing.assert_array_equal(getattr(logged.samples.order_parameters, name), running)
    np.testing.assert_allclose(logged.samples.nearest, flight.samples.nearest, rtol=0, atol=1e-4)


def test_all_flags_of_a_drone_are_kept(pair):
    flight, logged = pair
    np.testing.assert_array_equal(logged.samples.status, flight.samples.status)
    assert {OUTSIDE, CLOSE} & set(logged.samples.status.ravel())


def test_what_a_flight_itself_does_not_tell(pair):
    flight, logged = pair
    simulation = Simulation(A, CROWDED, flight.dynamics, 3)
    record = simulation.run(12.0, whole_states=True)
    np.testing.assert_array_equal(logged.digests, state_digests(record.qpos, record.qvel))
    np.testing.assert_array_equal(logged.quaternion, record.qpos[..., 3:].astype(np.float32))
    np.testing.assert_array_equal(logged.body_rates, record.qvel[..., 3:].astype(np.float32))
    assert tuple(values[-1] for values in logged.running_fitness) == tuple(flight.fitness)
    assert sorted(logged.states) == [0.0, 10.0]
    simulation.restore(logged.states[10.0])
    assert simulation.time == 10.0
    ours = {"flock.xml", "scenario.toml", "parameters.json", RUN_COPY}
    assert set(logged.attachments) == ours | {"layout.json", "blueprint.rbl.gz"}
    assert logged.metadata["seed"] == "3"
    assert json.loads(logged.result["fitness"]) == flight.fitness._asdict()


def test_one_drone_has_no_nearest(tmp_path):
    flight = fly(A, scenario=CROWDED.replace(drones=1), dynamics="point_mass", log=tmp_path / "a.mcap")
    logged = read_log(tmp_path / "a.mcap")
    np.testing.assert_array_equal(logged.samples.nearest, flight.samples.nearest)


@pytest.mark.slow
def test_ten_minutes_of_thirty_drones_are_read_in_two_seconds(tmp_path):
    fly(A, dynamics="point_mass", log=tmp_path / "a.mcap", keep_samples=False)
    read_log(tmp_path / "a.mcap")
    began = time.perf_counter()
    logged = read_log(tmp_path / "a.mcap")
    assert time.perf_counter() - began < 2
    assert logged.samples.position.shape == (6001, 30, 3)


def test_a_last_tick_without_its_figures_is_left_out(good, tmp_path):
    def drop(topic, when, data):
        return None if (topic, when) == ("/metrics", 3_000_000_000) else (topic, when, data)

    logged = read_log(rebuild(good, tmp_path / "a.mcap", change=drop, result=False))
    assert logged.samples.t[-1] == pytest.approx(2.9)
    assert logged.flown == logged.samples.t[-1]
    assert not logged.complete


def test_a_rebuilt_log_is_the_same(good, tmp_path):
    logged, again = read_log(good), read_log(rebuild(good, tmp_path / "a.mcap"))
    np.testing.assert_array_equal(again.digests, logged.digests)
    assert isinstance(again, LoggedFlight)
    assert (again.metadata, again.result, again.events) == (logged.metadata, logged.result, logged.events)


def refuse(path: Path, words: str) -> None:
    with pytest.raises(LogError, match=words) as refusal:
        read_log(path)
    assert str(refusal.value).startswith(f"log: {path}: ")
    assert "\n" not in str(refusal.value)


def test_files_that_are_no_logs_are_refused(tmp_path):
    refuse(tmp_path / "none.mcap", "no such file")
    refuse(tmp_path, "is not a file")
    for content, words in ((b"", "is empty"), (b"hello world" * 9, "is not an MCAP file")):
        (tmp_path / "a.mcap").write_bytes(content)
        refuse(tmp_path / "a.mcap", words)
    refuse(foreign(tmp_path / "b.mcap"), "is no log of a flight")


def test_what_is_unfinished_or_damaged_suggests_recovery(good, tmp_path):
    content, path = good.read_bytes(), tmp_path / "a.mcap"
    path.write_bytes(content[:-1])
    refuse(path, "unfinished or cut off; `moflock replay --recover .*a.mcap` saves what is intact")
    chunk = content.index(b"\x04\0\0\0zstd")
    refuse(flipped(good, path, chunk + 500), "chunk.*--recover")
    refuse(
        flipped(good, path, content.index(b"<mujoco")), "the checksum of the attachment flock.xml is wrong.*--recover"
    )
    refuse(flipped(good, path, content.index(b"drones = 3") + 9), "the copy run.json differ.*--recover")
    refuse(flipped(good, path, len(content) - 20), "footer is damaged|checksum of its summary")
    refuse(flipped(good, path, chunk - 37), "no record|less than its summary|within")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"log_version": "3"}, "log_version: 3 is newer than 2"),
        ({"log_version": "1"}, "log_version: 1 is older than 2"),
        ({"log_version": None}, "log_version: 'missing'"),
        ({"seed": "-x"}, "seed: '-x'"),
        ({"seed": "9" * 5000}, "seed: '9"),
        ({"dynamics": "boat"}, "dynamics: 'boat'"),
        ({"parameters": "[" * 100_000}, "parameters"),
        ({"parameters": "{}"}, "r0_rep: missing"),
        ({"parameters": json.dumps(A._asdict() | {"p_rep": 10**400})}, "p_rep|parameters"),
        ({"scenario": "drones = ["}, "not TOML"),
        ({"scenario": "drones = -3"}, "drones: -3"),
        ({"scenario": "wings = 3"}, "wings: unknown"),
        ({"scenario": "drones = 4\nduration = 3.0"}, "bytes; with 4 drones it must be"),
        ({"scenario": "drones = 3\nduration = 3.0\nsample_period = 0.15"}, "not those of samples every 0.15 s"),
        ({"scenario": "drones = 3\nduration = 2.0"}, "its times are not those"),
    ],
)
def test_a_run_that_cannot_be_is_refused(good, tmp_path, changes, words):
    refuse(rebuild(good, tmp_path / "a.mcap", run=changes), words)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda t, w, d: (t, w, d[:-1]), "bytes"),
        (lambda t, w, d: (t, w, b"\xff" * len(d)), "not laid out"),
        (lambda t, _, d: (t, 0, d), "times"),
        (lambda t, w, d: (t, w + (1 << 60), d), "out of bounds"),
        (lambda *_: None, "holds no samples"),
    ],
)
def test_messages_of_another_layout_are_refused(good, tmp_path, spoil, words):
    def change(topic, when, data):
        return spoil(topic, when, data) if topic == "/swarm/points" else (topic, when, data)

    refuse(rebuild(good, tmp_path / "a.mcap", change=change), words)


def test_events_and_states_that_are_none_are_refused(good, tmp_path):
    for topic, words in (("/log", "no event of a flight"), ("/sim/state", "no state of a flight")):

        def change(old, when, data, topic=topic):
            return (topic, when, b"\xff\xff") if old == "/scene" else (old, when, data)

        refuse(rebuild(good, tmp_path / "a.mcap", change=change), words)


def test_a_status_without_a_meaning_is_refused(good, tmp_path):
    def change(topic, when, data):
        blue = bytes([66, 165, 245, 255])
        return (topic, when, data.replace(blue + b"\0", blue + b"\x08"))

    refuse(rebuild(good, tmp_path / "a.mcap", change=change), "a status is none")


def test_a_small_file_does_not_unpack_to_a_huge_one(tmp_path):
    refuse(bomb(tmp_path / "a.mcap", 65 << 20), "it must be at most 67108864")


def test_figures_of_another_layout_are_refused(good, tmp_path):
    def change(topic, when, data):
        return (topic, when, Metrics(tick=1).SerializeToString() if topic == "/metrics" else data)

    refuse(rebuild(good, tmp_path / "a.mcap", change=change), "/metrics: a message of 3 bytes")
