"""Live server of a running flight for Foxglove and Lichtblick on this machine, with the topics of its log."""

from __future__ import annotations

import collections
import math
import queue
import time
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from moflock_mj.dynamics.airframe_models import load_airframe
from moflock_mj.errors import RenderError
from moflock_mj.log.encoder import SampleBlock, event_message, fill_metrics, fill_points, fill_transforms
from moflock_mj.log.flight_logger import sample_block
from moflock_mj.log.scene_encoder import arena_points, scene
from moflock_mj.log.schemas import CHANNELS, metrics_record, points_record, schema_of, timestamps, transforms_record
from moflock_mj.metrics.events import FlightEvent
from moflock_mj.metrics.samples import SampleBuffer
from moflock_mj.simulation.simulation import Simulation

HOST = "127.0.0.1"
PORT = 8765
"""Default port of Foxglove and Lichtblick."""

_STATIC = ("/scene", "/arena")
_NOT_SERVED = ("/sim/state", "/mavlink")


class LiveServer:
    """WebSocket server of a simulation; a context manager and observer of `fly`.

    Samples are sent when they are due, so that the flight waits for the clock. Nothing is encoded without a viewer.

    Args:
        simulation: the simulation.
        port: port on 127.0.0.1; 0 for any free port.
        speed: simulated seconds per real second; infinite for no limit.

    Raises:
        RenderError: foxglove-sdk is not installed, the port is taken, or the speed is not above 0.
    """

    def __init__(self, simulation: Simulation, *, port: int = PORT, speed: float = 1.0) -> None:
        if not speed > 0:
            raise RenderError(f"live speed: {speed:g} is out of bounds: it must be above 0")
        foxglove = _foxglove()
        self._simulation, self._speed = simulation, speed
        drones, scenario = simulation.scenario.drones, simulation.scenario
        outline, radius = simulation.arena.outline(), load_airframe(scenario.airframe).radius
        self._static = {
            "/scene": scene(outline, scenario.altitude, drones, radius).SerializeToString(),
            "/arena": arena_points(outline, scenario.altitude).SerializeToString(),
        }
        self._records = {
            "/swarm/points": points_record(drones),
            "/tf": transforms_record(drones),
            "/metrics": metrics_record(),
        }
        # The channels and the server only hold weak references to the context.
        self._context = context = foxglove.Context()
        self._channels = {
            topic: _channel(foxglove, context, topic, message)
            for topic, message in CHANNELS.items()
            if topic not in _NOT_SERVED
        }
        self._subscriptions: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._server = _start(foxglove, context, port, _SubscriptionListener(self._subscriptions))
        self._began = math.nan
        self._ticks = 0

    @property
    def port(self) -> int:
        """Port of the server."""
        return int(self._server.port)

    @property
    def needs_states(self) -> bool:
        """Whether a viewer is subscribed, so that the next samples must include whole states."""
        return any(channel.has_sinks() for channel in self._channels.values())

    def write(self, time_ns: NDArray[np.int64], record: SampleBuffer, events: list[FlightEvent]) -> None:
        """Send samples and their events, each when it is due.

        Args:
            time_ns: simulated times of the samples, (K,), ns.
            record: samples; without whole states they are not sent, but still paced.
            events: events in these samples.
        """
        if math.isnan(self._began):
            self._began = time.monotonic() - int(time_ns[0]) * 1e-9 / self._speed
        if len(record.qpos):
            self._show(sample_block(time_ns, record, self._simulation.scenario), events)
        else:
            self._await(int(time_ns[-1]))
        self._ticks += len(time_ns)

    def finish(self, record: SampleBuffer) -> None:
        """No-op: all samples have been sent."""

    def store_state(self) -> None:
        """No-op: a live view is never resumed."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.stop()

    def _show(self, block: SampleBlock, events: list[FlightEvent]) -> None:
        """Send each sample when it is due."""
        messages, waiting = self._messages(block), collections.deque(events)
        while not self._subscriptions.empty():
            topic = self._subscriptions.get()
            self._channels[topic].log(self._static[topic], log_time=int(block.time_ns[0]))
        for k, time_ns in enumerate(block.time_ns.tolist()):
            self._await(time_ns)
            self._server.broadcast_time(time_ns)
            while waiting and waiting[0].time_ns <= time_ns:
                message = event_message(waiting[0], self._simulation.scenario.drones)
                self._channels["/log"].log(message, log_time=waiting.popleft().time_ns)
            for topic, encoded in messages.items():
                self._channels[topic].log(encoded[k], log_time=time_ns)

    def _await(self, time_ns: int) -> None:
        """Sleep until a simulated time is due."""
        wait = self._began + time_ns * 1e-9 / self._speed - time.monotonic()
        if wait > 0:
            time.sleep(wait)

    def _messages(self, block: SampleBlock) -> dict[str, list[bytes]]:
        """Encode the messages of each topic, one per sample."""
        count = len(block.time_ns)
        stamps = timestamps(block.time_ns)
        rows = {topic: record.rows(count) for topic, record in self._records.items()}
        fill_points(rows["/swarm/points"], block, stamps)
        fill_transforms(rows["/tf"], block.qpos, stamps)
        fill_metrics(rows["/metrics"], block, np.arange(self._ticks, self._ticks + count))
        return {topic: [row.tobytes() for row in messages] for topic, messages in rows.items()}


class _SubscriptionListener:
    """Listener that queues subscriptions to topics that are sent only once."""

    def __init__(self, subscriptions: queue.SimpleQueue[str]) -> None:
        self._subscriptions = subscriptions

    def on_subscribe(self, client: Any, channel: Any) -> None:  # noqa: ARG002 - the server's signature
        if channel.topic in _STATIC:
            self._subscriptions.put(channel.topic)

    def on_unsubscribe(self, client: Any, channel: Any) -> None:
        """No-op: the server itself stops sending."""


def _foxglove() -> Any:
    try:
        import foxglove  # noqa: PLC0415 - an extra
    except ImportError as problem:
        raise RenderError("live: foxglove-sdk is not installed; pip install 'moflock-mj[live]'") from problem
    return foxglove


def _channel(foxglove: Any, context: Any, topic: str, message: Any) -> Any:
    name, descriptors = schema_of(message)
    schema = foxglove.Schema(name=name, encoding="protobuf", data=descriptors)
    return foxglove.Channel(topic, schema=schema, message_encoding="protobuf", context=context)


def _start(foxglove: Any, context: Any, port: int, listener: _SubscriptionListener) -> Any:
    try:
        return foxglove.start_server(
            name="moflock",
            host=HOST,
            port=port,
            context=context,
            capabilities=[foxglove.Capability.Time],
            server_listener=listener,
        )
    except (RuntimeError, OSError, OverflowError) as problem:
        raise RenderError(f"live: port {port} of {HOST}: {problem}") from problem
