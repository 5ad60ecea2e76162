"""The log: read back by independent readers, finished or killed, and what happens when the disk says no."""

import contextlib
import errno
import hashlib
import io
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from mcap.reader import make_reader
from mcap.records import Attachment as AttachmentRecord
from mcap.records import Channel, Chunk, Message, Metadata
from mcap.stream_reader import StreamReader
from mcap_protobuf.decoder import DecoderFactory

from moflock_mj.errors import LogError
from moflock_mj.log import writer
from moflock_mj.log.foxglove_layout import viewer_layout
from moflock_mj.log.schemas import CHANNELS, FITNESS_FIELDS, ORDER_PARAMETER_FIELDS, POINT, STATUS_RGBA, STATUS_ROW
from moflock_mj.log.writer import FlightLog
from tests.support.logs import TICK, cut, header, some_flight, write_log
from tests.support.waiting import wait_until


def decoded(path: Path, topic: str) -> list[tuple[Message, object]]:
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        return [(message, content) for _, _, message, content in reader.iter_decoded_messages(topics=[topic])]


def raw_messages(path: Path) -> list[tuple[int, int, bytes]]:
    with path.open("rb") as stream:
        return [(m.channel_id, m.log_time, m.data) for _, _, m in make_reader(stream).iter_messages()]


@pytest.mark.parametrize("drones", [1, 3, 1000])
def test_points_are_the_flight_in_single_precision(tmp_path, drones):
    flight = some_flight(drones, 20)
    messages = decoded(write_log(tmp_path / "a.mcap", flight), "/swarm/points")
    assert [message.log_time for message, _ in messages] == flight.time_ns.tolist()
    assert [cloud.timestamp.ToNanoseconds() for _, cloud in messages] == flight.time_ns.tolist()
    assert all(cloud.frame_id == "world" and cloud.pose.orientation.w == 1.0 for _, cloud in messages)
    points = np.array([np.frombuffer(cloud.data, POINT) for _, cloud in messages])
    np.testing.assert_array_equal(points["qpos"], flight.qpos.astype(np.float32))
    np.testing.assert_array_equal(points["qvel"], flight.qvel.astype(np.float32))
    np.testing.assert_array_equal(points["desired_velocity"][..., :2], flight.desired_velocity.astype(np.float32))
    assert not points["desired_velocity"][..., 2].any()
    np.testing.assert_array_equal(points["rgba"], STATUS_RGBA[STATUS_ROW[flight.status]])


def test_the_cloud_describes_its_own_fields(tmp_path):
    flight = some_flight(2, 1)
    ((_, cloud),) = decoded(write_log(tmp_path / "a.mcap", flight), "/swarm/points")
    assert cloud.point_stride == POINT.itemsize
    numeric = {1: "<u1", 7: "<f4"}
    described = np.dtype(
        {
            "names": [field.name for field in cloud.fields],
            "formats": [numeric[field.type] for field in cloud.fields],
            "offsets": [field.offset for field in cloud.fields],
            "itemsize": cloud.point_stride,
        }
    )
    points = np.frombuffer(cloud.data, described)
    for name, values in {"x": flight.qpos[0, :, 0], "qw": flight.qpos[0, :, 3], "vz": flight.qvel[0, :, 2]}.items():
        np.testing.assert_array_equal(points[name], values.astype(np.float32))
    np.testing.assert_array_equal(points["r"], flight.qvel[0, :, 5].astype(np.float32))
    np.testing.assert_array_equal(points["desired_vy"], flight.desired_velocity[0, :, 1].astype(np.float32))
    np.testing.assert_array_equal(points["alpha"], [255, 255])


@pytest.mark.parametrize("period", [1, 5])
def test_transforms_are_the_poses(tmp_path, period):
    flight = some_flight(101, 20)
    messages = decoded(write_log(tmp_path / "a.mcap", flight, transform_period=period), "/tf")
    assert [message.log_time for message, _ in messages] == flight.time_ns[::period].tolist()
    for (_, content), time_ns, qpos in zip(messages, flight.time_ns[::period], flight.qpos[::period], strict=True):
        assert [t.child_frame_id for t in content.transforms] == [f"drone_{drone:03d}" for drone in range(101)]
        assert {t.parent_frame_id for t in content.transforms} == {"world"}
        assert {t.timestamp.ToNanoseconds() for t in content.transforms} == {int(time_ns)}
        poses = [
            (
                *(t.translation.x, t.translation.y, t.translation.z),
                *(t.rotation.w, t.rotation.x, t.rotation.y),
                t.rotation.z,
            )
            for t in content.transforms
        ]
        np.testing.assert_array_equal(poses, qpos)


def test_metrics_are_the_running_figures_and_the_digest_of_the_exact_state(tmp_path):
    flight = some_flight(3, 25)
    messages = decoded(write_log(tmp_path / "a.mcap", flight), "/metrics")
    for tick, (_, metrics) in enumerate(messages):
        assert metrics.tick == tick
        assert [getattr(metrics, name) for name in ORDER_PARAMETER_FIELDS] == flight.order_parameters[tick].tolist()
        assert [getattr(metrics, name) for name in FITNESS_FIELDS] == flight.fitness[tick].tolist()
        state = flight.qpos[tick].tobytes() + flight.qvel[tick].tobytes()
        assert metrics.state_digest == hashlib.blake2b(state, digest_size=16).digest()
    assert len(messages) == 25


def test_long_flights_keep_their_times(tmp_path):
    flight = some_flight(1, 3)._replace(time_ns=np.array([1, 4_000 * 10**9 + 999_999_999, 10**16]))
    messages = decoded(write_log(tmp_path / "a.mcap", flight), "/swarm/points")
    assert [cloud.timestamp.ToNanoseconds() for _, cloud in messages] == flight.time_ns.tolist()


def test_events_states_and_the_scene(tmp_path):
    path = write_log(tmp_path / "a.mcap", some_flight(3, 20))
    ((event, log),) = decoded(path, "/log")
    assert (event.log_time, log.level, log.message, log.name) == (20 * TICK, 3, "drone 0 left the arena", "drone_00")
    states = decoded(path, "/sim/state")
    assert [(m.log_time, s.state) for m, s in states] == [
        (10 * TICK, b"state at 1000000000"),
        (20 * TICK, b"state at 2000000000"),
    ]
    ((first, scene),) = decoded(path, "/scene")
    assert first.log_time == 0
    assert [entity.id for entity in scene.entities] == ["ground", "arena", "labels", "drone_00", "drone_01", "drone_02"]
    assert scene.entities[3].frame_locked
    assert [text.text for text in scene.entities[2].texts] == ["x: 500 m", "y: 500 m", "altitude 10 m"]


def test_metadata_and_attachments_come_before_the_first_message(tmp_path):
    path = write_log(tmp_path / "a.mcap", some_flight(3, 20))
    with path.open("rb") as stream:
        records = list(StreamReader(stream, validate_crcs=True, emit_chunks=True).records)
    kinds = [type(r) for r in records if isinstance(r, Metadata | AttachmentRecord | Chunk)]
    assert kinds == [Metadata, AttachmentRecord, Chunk, Chunk, Chunk, Chunk, Metadata]
    run, result = (r for r in records if isinstance(r, Metadata))
    assert (run.name, run.metadata) == ("moflock.run", {"log_version": "2", "seed": "1"})
    assert (result.name, result.metadata) == ("moflock.result", {"F_1": "0.5"})
    (attachment,) = (r for r in records if isinstance(r, AttachmentRecord))
    assert (attachment.name, attachment.data) == ("scenario.toml", b"drones = 3\n")


def test_channels_have_the_same_numbers_in_every_log(tmp_path):
    path = write_log(tmp_path / "a.mcap", some_flight(1, 1))
    with path.open("rb") as stream:
        channels = {r.id: r.topic for r in StreamReader(stream).records if isinstance(r, Channel)}
    assert channels == dict(enumerate(CHANNELS, start=1))


@pytest.mark.parametrize("block", [1, 7, 10])
def test_messages_are_the_same_byte_for_byte(tmp_path, block):
    one = write_log(tmp_path / "one.mcap", some_flight(3, 45), transform_period=2)
    two = write_log(tmp_path / "two.mcap", some_flight(3, 45), transform_period=2)
    assert one.read_bytes() == two.read_bytes()
    other = write_log(tmp_path / "other.mcap", some_flight(3, 45), block=block, transform_period=2)
    kept = [[m for m in raw_messages(path) if m[0] != list(CHANNELS).index("/sim/state") + 1] for path in (one, other)]
    assert kept[0] == kept[1]


@pytest.mark.parametrize(("drones", "block"), [(1, 7), (30, 10), (1000, 25)])
def test_the_indexes_lead_to_every_message(tmp_path, drones, block):
    path = write_log(tmp_path / "a.mcap", some_flight(drones, 50), block=block, transform_period=3)
    file = path.read_bytes()
    summary = make_reader(io.BytesIO(file), validate_crcs=True).get_summary()
    found = []
    for index in summary.chunk_indexes:
        chunk = next(
            StreamReader(io.BytesIO(file[index.chunk_start_offset :]), skip_magic=True, emit_chunks=True).records
        )
        content = zstandard.decompress(chunk.data)
        assert len(chunk.data) == index.compressed_size
        times = []
        for channel, offset in index.message_index_offsets.items():
            entries = next(StreamReader(io.BytesIO(file[offset:]), skip_magic=True).records)
            assert entries.channel_id == channel
            times += [time_ns for time_ns, _ in entries.records]
            for time_ns, place in entries.records:
                message = next(StreamReader(io.BytesIO(content[place:]), skip_magic=True).records)
                assert (message.channel_id, message.log_time) == (channel, time_ns)
                found.append((time_ns, channel, message.data))
        assert (chunk.message_start_time, chunk.message_end_time) == (min(times), max(times))
    streamed = [r for r in StreamReader(io.BytesIO(file), validate_crcs=True).records if isinstance(r, Message)]
    assert sorted(found) == sorted((m.log_time, m.channel_id, m.data) for m in streamed)
    counts = summary.statistics.channel_message_counts
    assert counts == dict(Counter(message.channel_id for message in streamed))
    assert summary.statistics.message_count == len(streamed)


def test_a_long_block_becomes_many_chunks(tmp_path):
    flight = some_flight(1000, 60)
    path = write_log(tmp_path / "a.mcap", flight, block=60)
    with path.open("rb") as stream:
        chunks = [r for r in StreamReader(stream, emit_chunks=True).records if isinstance(r, Chunk)]
    assert max(chunk.uncompressed_size for chunk in chunks) < 2 << 20
    assert [message.log_time for message, _ in decoded(path, "/swarm/points")] == flight.time_ns.tolist()


def test_a_flight_faster_than_the_disk_waits(tmp_path, monkeypatch):
    written = []
    quick = writer.Encoder.block

    def slow(self, block):
        time.sleep(0.01)
        quick(self, block)
        written.append(block)

    monkeypatch.setattr(writer.Encoder, "block", slow)
    with FlightLog(tmp_path / "a.mcap", header(3)) as log:
        for number, block in enumerate(cut(some_flight(3, 40), 10)):
            log.write(block)
            assert len(written) >= number
        log.settle()
        assert len(written) == 4


def recovered_times(path: Path) -> list[int]:
    """Log times of the points that a streaming reader finds before the file ends in the middle of something."""
    times = []
    with contextlib.suppress(Exception), path.open("rb") as stream:
        for record in StreamReader(stream, validate_crcs=True).records:
            if isinstance(record, Message) and record.channel_id == 1:
                times.append(record.log_time)
    return times


@pytest.mark.slow
def test_a_killed_writer_loses_at_most_the_last_second(tmp_path):
    program = """
import sys, time
from moflock_mj.log.writer import FlightLog
from tests.support.logs import cut, header, some_flight
log = FlightLog(sys.argv[1], header(3))
for part in cut(some_flight(3, 57), 3):
    log.write(part)
time.sleep(120)
"""
    part = tmp_path / "a.mcap.part"
    root = Path(__file__).parents[3]
    with subprocess.Popen([sys.executable, "-c", program, tmp_path / "a.mcap"], cwd=root) as process:
        wait_until(lambda: len(recovered_times(part)) >= 54, pause=0.05)
        process.send_signal(signal.SIGKILL)
    assert not (tmp_path / "a.mcap").exists()
    assert recovered_times(part) == [tick * TICK for tick in range(1, 55)]
    # What a dead writer left does not hinder the next one.
    write_log(tmp_path / "a.mcap", some_flight(3, 20))
    assert not part.exists()


@pytest.mark.parametrize("block", [1, 3, 4, 10])
def test_what_waits_in_a_chunk_and_the_block_in_flight_are_at_most_a_second(tmp_path, block):
    path = write_log(tmp_path / "a.mcap", some_flight(1, 60), block=block)
    with path.open("rb") as stream:
        chunks = [r for r in StreamReader(stream, emit_chunks=True).records if isinstance(r, Chunk)]
    ends = np.array([chunk.message_end_time for chunk in chunks])
    assert np.diff(ends).max() <= 10 * TICK
    assert ends[-1] == 60 * TICK


class FullDisk(io.FileIO):
    """A file on a disk with room for so many bytes."""

    def __init__(self, path: Path, room: int) -> None:
        super().__init__(path, "wb")
        self.room = room

    def write(self, data: Any) -> int:
        if self.tell() + len(data) > self.room:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return super().write(data)


@pytest.mark.parametrize("room", [100, 30_000, 100_000, 10_000_000])
def test_a_full_disk_is_one_clear_line_and_leaves_nothing(tmp_path, monkeypatch, room):
    monkeypatch.setattr(writer, "_open", lambda _, part: io.BufferedWriter(FullDisk(part, room)))
    path = tmp_path / "a.mcap"
    flight = cut(some_flight(30, 400), 10)

    def fly() -> None:
        with FlightLog(path, header(30)) as log:
            for block in flight:
                log.write(block)
            log.finish()

    if room < 1_000_000:
        with pytest.raises(LogError) as failure:
            fly()
        assert str(failure.value) == f"log: {path}: no space left on device"
        assert list(tmp_path.iterdir()) == []
    else:
        fly()
        assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("place", ["file/a.mcap", "file/b/a.mcap", "folder"])
def test_a_place_that_cannot_be_written_is_refused_before_the_flight(tmp_path, place):
    (tmp_path / "file").touch()
    (tmp_path / "folder").mkdir()
    with pytest.raises(LogError, match=r"^log: .*(not a folder|is a folder|device)"):
        FlightLog(tmp_path / place, header(1))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "folder"]


def test_a_folder_that_is_missing_is_made(tmp_path):
    assert write_log(tmp_path / "deep" / "logs" / "a.mcap", some_flight(1, 1)).exists()


def test_an_older_log_stays_until_the_new_one_is_finished(tmp_path):
    path = tmp_path / "a.mcap"
    path.write_bytes(b"old")
    with FlightLog(path, header(1)) as log:
        log.write(some_flight(1, 10))
        assert path.read_bytes() == b"old"
        log.finish()
        log.abort()
    assert len(decoded(path, "/metrics")) == 10


def test_two_flights_do_not_write_the_same_log(tmp_path):
    with FlightLog(tmp_path / "a.mcap", header(1)) as log:
        with pytest.raises(LogError, match="another flight is writing it"):
            FlightLog(tmp_path / "a.mcap", header(1))
        log.write(some_flight(1, 10))
    assert len(decoded(tmp_path / "a.mcap", "/metrics")) == 10


@pytest.mark.parametrize(("error", "left"), [(KeyboardInterrupt, ["a.mcap"]), (RuntimeError, [])])
def test_an_interrupt_finishes_the_log_and_an_error_removes_it(tmp_path, error, left):
    def fly() -> None:
        with FlightLog(tmp_path / "a.mcap", header(1)) as log:
            log.write(some_flight(1, 15))
            raise error

    with pytest.raises(error):
        fly()
    assert [path.name for path in tmp_path.iterdir()] == left
    if left:
        assert len(decoded(tmp_path / "a.mcap", "/metrics")) == 15


def test_a_block_of_the_wrong_shape_is_refused(tmp_path):
    with FlightLog(tmp_path / "a.mcap", header(2)) as log:
        with pytest.raises(ValueError, match=r"qpos: shape \(5, 3, 7\) given, \(5, 2, 7\) expected"):
            log.write(some_flight(3, 5))
        log.abort()
        with pytest.raises(ValueError, match="is closed"):
            log.write(some_flight(2, 5))


def test_a_fault_of_the_writer_itself_is_not_lost(tmp_path):
    flight = some_flight(2, 5)
    with pytest.raises(LogError, match="IndexError"):
        write_log(tmp_path / "a.mcap", flight._replace(status=flight.status + 9))
    assert list(tmp_path.iterdir()) == []


def test_wild_states_are_logged_as_they_are(tmp_path):
    flight = some_flight(1, 2)
    flight.qpos[1] = [np.nan, np.inf, 1e300, 1, 0, 0, 0]
    points = decoded(write_log(tmp_path / "a.mcap", flight), "/swarm/points")
    (drone,) = np.frombuffer(points[1][1].data, POINT)
    np.testing.assert_array_equal(drone["qpos"], [np.nan, np.inf, np.inf, 1, 0, 0, 0])


def test_the_viewer_layout_shows_channels_and_fields_that_exist():
    layout = json.loads(viewer_layout(500.0))
    panels = layout["configById"]
    plotted = [path["value"] for panel in panels.values() for path in panel.get("paths", [])]
    fields = {f"/metrics.{name}" for name in (*ORDER_PARAMETER_FIELDS, *FITNESS_FIELDS)}
    assert set(plotted) == fields
    assert set(panels["3D!flock"]["topics"]) <= set(CHANNELS)
    placed = re.findall(r'"(?:first|second)": "([^"]+)"', json.dumps(layout["layout"]))
    assert sorted(placed) == sorted(panels)
