"""The live server: what a WebSocket client receives, and that a flight that nobody watches pays next to nothing."""

import json
import math
import socket
import struct
import threading
import time
from collections import defaultdict
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from moflock_mj import Scenario, load_point
from moflock_mj.errors import RenderError
from moflock_mj.log.schemas import POINT, Metrics
from moflock_mj.metrics.events import FlightEvent
from moflock_mj.metrics.samples import sample_times
from moflock_mj.simulation.simulation import Simulation
from tests.support.waiting import wait_until

pytest.importorskip("foxglove", reason="foxglove-sdk is not installed: the extra `live`")
client = pytest.importorskip("websockets.sync.client", reason="websockets is not installed: the extra `html` has it")

from moflock_mj.visualization.live_server import LiveServer  # noqa: E402 - after the extra is known to be there

SECONDS = 3.0


def simulation(drones: int = 5, duration: float = SECONDS) -> Simulation:
    scenario = Scenario(drones=drones, duration=duration, arena_side=120.0, start_spacing=5.0)
    return Simulation(load_point("A"), scenario, "point_mass", 1)


def fly_live(flown: Simulation, server: LiveServer) -> list[Any]:
    """Fly as `fly` does, a second at a time."""
    records, samples = [], 0
    while not flown.finished:
        record = flown.run(1.0, whole_states=server.needs_states)
        time_ns = sample_times(flown.scenario, samples, len(record.nearest))
        samples += len(record.nearest)
        server.write(time_ns, record, [FlightEvent(int(time_ns[0]), "warning", "a second begins", 0)])
        records.append(record)
    server.finish(records[-1])
    return records


class Viewer(threading.Thread):
    """A client that subscribes to all that is offered, and keeps what comes."""

    def __init__(self, port: int) -> None:
        super().__init__(daemon=True)
        self.port, self.schemas, self.times = port, {}, []
        self.messages: dict[str, list[tuple[int, bytes]]] = defaultdict(list)
        self.subscribed = threading.Event()

    def run(self) -> None:
        topics = {}
        with client.connect(f"ws://127.0.0.1:{self.port}", subprotocols=["foxglove.sdk.v1"], max_size=None) as socket:
            for message in socket:
                if isinstance(message, str):
                    for channel in json.loads(message).get("channels", []):
                        topics[channel["id"]] = channel["topic"]
                        self.schemas[channel["topic"]] = channel["schemaName"]
                    wanted = [{"id": number, "channelId": number} for number in topics]
                    socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
                    if topics:
                        self.subscribed.set()
                elif message[0] == 1:
                    number, time_ns = struct.unpack_from("<IQ", message, 1)
                    self.messages[topics[number]].append((time_ns, message[13:]))
                elif message[0] == 2:
                    self.times.append(*struct.unpack_from("<Q", message, 1))


@contextmanager
def watched(server: LiveServer):
    viewer = Viewer(server.port)
    viewer.start()
    assert viewer.subscribed.wait(10)
    # The server takes one subscription after the other; the last one counts.
    wait_until(lambda: all(channel.has_sinks() for channel in server._channels.values()), seconds=10)
    assert server.needs_states
    yield viewer
    viewer.join(10)


def test_client_receives_the_flight_as_its_log_would_hold_it() -> None:
    flown = simulation()
    with LiveServer(flown, port=0, speed=20.0) as server, watched(server) as viewer:
        records = fly_live(flown, server)
        wait_until(lambda: len(viewer.messages["/metrics"]) == 31 and viewer.times[-1:] == [SECONDS * 1e9], seconds=10)
        server.__exit__(None, None, None)
    assert viewer.schemas == {
        "/swarm/points": "foxglove.PointCloud",
        "/tf": "foxglove.FrameTransforms",
        "/metrics": "moflock.Metrics",
        "/log": "foxglove.Log",
        "/scene": "foxglove.SceneUpdate",
        "/arena": "foxglove.PointCloud",
    }
    expected = np.concatenate([record.position for record in records])
    points = viewer.messages["/swarm/points"]
    assert [time_ns for time_ns, _ in points] == list(range(0, round(SECONDS * 1e9) + 1, 100_000_000))
    clouds = [np.frombuffer(PointCloud.FromString(data).data, POINT) for _, data in points]
    np.testing.assert_array_equal([cloud["qpos"][:, :3] for cloud in clouds], expected.astype(np.float32))
    ticks = [Metrics.FromString(data).tick for _, data in viewer.messages["/metrics"]]
    assert ticks == list(range(31))
    assert len(viewer.messages["/log"]) == 3
    assert {entity.id for entity in SceneUpdate.FromString(viewer.messages["/scene"][0][1]).entities} >= {"arena"}
    assert viewer.times[-1] == SECONDS * 1e9


def test_samples_come_when_they_are_due() -> None:
    flown = simulation(duration=1.0)
    with LiveServer(flown, port=0, speed=1.0) as server:
        began = time.monotonic()
        fly_live(flown, server)
        assert 0.95 < time.monotonic() - began < 2.0


def test_without_a_client_a_second_of_flight_costs_less_than_a_fiftieth_of_its_flying() -> None:
    """A rigid-body flight of 30 drones takes 2 ms for each simulated second on a fast machine."""
    flown, seconds = simulation(), 2000
    record = flown.run(1.0)
    time_ns = sample_times(flown.scenario, 0, len(record.nearest))
    with LiveServer(flown, port=0, speed=math.inf) as server:
        began = time.process_time()
        for _ in range(seconds):
            assert not server.needs_states
            server.write(time_ns, record, [])
        server.finish(record)
        cost = (time.process_time() - began) / seconds
    assert cost < 0.02 * 2e-3, f"{1e6 * cost:.0f} us"


def test_a_taken_port_and_a_bad_speed_are_refused_in_one_line() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(RenderError, match=rf"^live: port {port} of 127\.0\.0\.1: .+$"):
            LiveServer(simulation(), port=port)
    with pytest.raises(RenderError, match=r"live speed: 0 given.*above 0"):
        LiveServer(simulation(), port=0, speed=0.0)
