"""Schemas of a log: channels, message types, and binary layout of the messages of each sample.

The messages of a sample are protobuf, but are not created as protobuf objects. Their length is constant within a
flight, so that each is a NumPy record: constant bytes (tags, lengths, names) around fields that are filled for many
samples at once. The writer fills such records. A reader extracts the drones from a `foxglove.PointCloud` with
`np.frombuffer(cloud.data, POINT)`.
"""

from __future__ import annotations

import hashlib
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from mcap_protobuf.schema import build_file_descriptor_set

from moflock_mj.metrics.catalogue import METRICS, OBJECTIVES
from moflock_mj.metrics.order_parameters import CLOSE, OUTSIDE, TOUCHED

# Increases when a reader of the older layout would misread the newer one; `log_version` in the metadata.
LOG_VERSION = 2
RUN_METADATA = "moflock.run"
RUN_COPY = "run.json"  # copy as an attachment, which has a checksum
RESULT_METADATA = "moflock.result"
# Entries of `moflock.run` in the log of a resumed flight: time of the state in s, and name of its log.
RESUMED_AT, RESUMED_FROM = "resumed_at", "resumed_from"
WORLD_FRAME = "world"

ORDER_PARAMETER_FIELDS = tuple(metric.symbol for metric in METRICS)
FITNESS_FIELDS = (*(metric.fitness_symbol for metric in METRICS), *OBJECTIVES)
# Field numbers of `moflock.Metrics`, which never change; a new metric takes the next free number.
_TICK_NUMBER, _DIGEST_NUMBER = 16, 17
METRICS_NUMBERS = {
    **{metric.symbol: metric.number for metric in METRICS},
    **{metric.fitness_symbol: metric.fitness_number for metric in METRICS},
    **OBJECTIVES,
    "tick": _TICK_NUMBER,
    "state_digest": _DIGEST_NUMBER,
}

# One drone in the point cloud: qpos and qvel in MuJoCo's order (position m and velocity m/s in the world frame,
# quaternion wxyz from body to world, rates rad/s in the body frame), the commanded velocity m/s in the world frame, a
# colour, and the status: flags OUTSIDE, CLOSE and TOUCHED of `metrics.order_parameters`.
POINT = np.dtype(
    [
        ("qpos", "<f4", (7,)),
        ("qvel", "<f4", (6,)),
        ("desired_velocity", "<f4", (3,)),
        ("rgba", "u1", (4,)),
        ("status", "u1"),
    ]
)
POINT_FLOATS = (
    *("x", "y", "z", "qw", "qx", "qy", "qz"),
    *("vx", "vy", "vz", "p", "q", "r"),
    *("desired_vx", "desired_vy", "desired_vz"),
)
# Four fields of a byte each, the `rgba-fields` that Foxglove and Lichtblick select automatically.
POINT_COLOURS = ("red", "green", "blue", "alpha")
# (4, 4) u8, colour of a drone by its worst flag: none, outside the arena, closer than r_coll to another, has touched.
STATUS_RGBA = np.array(
    [[66, 165, 245, 255], [255, 202, 40, 255], [255, 112, 32, 255], [229, 28, 52, 255]], dtype=np.uint8
)

# (8,) u8, row of STATUS_RGBA for each combination of flags.
STATUS_ROW = np.array(
    [3 if flags & TOUCHED else 2 if flags & CLOSE else 1 if flags & OUTSIDE else 0 for flags in range(8)], np.uint8
)

_VARINT, _DOUBLE, _BYTES = 0, 1, 2  # protobuf's wire types
_TAGGED_DOUBLE = np.dtype([("tag", "u1"), ("value", "<f8")])
_DIGEST_SIZE = 16
# The five bytes of a padded varint: seven bits each, the lowest first, and a continuation bit.
_SEPTETS = np.arange(0, 35, 7)
_MORE_FOLLOW = np.array([0x80, 0x80, 0x80, 0x80, 0])
_TIMESTAMP_TAGS = (0x08, 0x10)  # tags of the varints `seconds` and `nanos`


def _own_messages() -> tuple[Any, Any, Any]:
    """Create the classes of `moflock.Metrics`, `moflock.SimState` and `moflock.Packet`, in a separate pool."""
    file = FileDescriptorProto(name="moflock/log.proto", package="moflock", syntax="proto3")
    kinds = FieldDescriptorProto
    doubles = [(name, kinds.TYPE_DOUBLE) for name in (*ORDER_PARAMETER_FIELDS, *FITNESS_FIELDS)]
    messages = {
        "Metrics": [*doubles, ("tick", kinds.TYPE_UINT64), ("state_digest", kinds.TYPE_BYTES)],
        "SimState": [("version", kinds.TYPE_UINT32), ("state", kinds.TYPE_BYTES)],
        # A MAVLink packet: the vehicle's system id (0: all on the link), and whether it was sent to the vehicle.
        "Packet": [("system", kinds.TYPE_UINT32), ("sent", kinds.TYPE_BOOL), ("packet", kinds.TYPE_BYTES)],
    }
    for message, fields in messages.items():
        descriptor = file.message_type.add(name=message)
        for place, (name, kind) in enumerate(fields, start=1):
            number = METRICS_NUMBERS[name] if message == "Metrics" else place
            descriptor.field.add(name=name, number=number, type=kind, label=kinds.LABEL_OPTIONAL)
    pool = DescriptorPool()
    pool.Add(file)
    metrics, state, packet = (GetMessageClass(pool.FindMessageTypeByName(f"moflock.{name}")) for name in messages)
    return metrics, state, packet


Metrics, SimState, Packet = _own_messages()

# Channels in the order of their ids, 1 to 8, which are the same in every log.
CHANNELS: dict[str, Any] = {
    "/swarm/points": PointCloud,
    "/tf": FrameTransforms,
    "/metrics": Metrics,
    "/log": Log,
    "/scene": SceneUpdate,
    "/sim/state": SimState,
    "/arena": PointCloud,
    "/mavlink": Packet,
}


def schema_of(message_class: Any) -> tuple[str, bytes]:
    """Full name of a message class, and its FileDescriptorSet with all imports."""
    return message_class.DESCRIPTOR.full_name, build_file_descriptor_set(message_class).SerializeToString(
        deterministic=True
    )


def frame_name(drone: int, drones: int) -> str:
    """Name of a drone's frame in /tf; all names of a flight have the same length."""
    return f"drone_{drone:0{max(2, len(str(drones - 1)))}d}"


def state_digests(qpos: npt.NDArray[np.float64], qvel: npt.NDArray[np.float64]) -> npt.NDArray[np.uint8]:
    """Digests of the exact states of K samples, (K, 16).

    Args:
        qpos: (K, N, 7), position (m, world) and quaternion wxyz.
        qvel: (K, N, 6), velocity (m/s, world) and body rates (rad/s, body).
    """
    samples, drones = qpos.shape[:2]
    states = np.concatenate((qpos.reshape(samples, 7 * drones), qvel.reshape(samples, 6 * drones)), axis=1, dtype="<f8")
    digests = b"".join([hashlib.blake2b(state, digest_size=_DIGEST_SIZE).digest() for state in states])
    return np.frombuffer(digests, np.uint8).reshape(samples, _DIGEST_SIZE)


class WireRecord(NamedTuple):
    """Layout of a protobuf message of constant length.

    Attributes:
        dtype: layout of the bytes, with a field for each part that varies between samples.
        constant: bytes of the message with zeros in the fields.
    """

    dtype: np.dtype[Any]
    constant: bytes

    def rows(self, count: int) -> npt.NDArray[Any]:
        """(count,) writable messages with zeros in the fields."""
        return np.frombuffer(bytearray(self.constant * count), self.dtype)


def points_record(drones: int) -> WireRecord:
    """`foxglove.PointCloud` with the fields `stamp` and `points`, (N,) of POINT."""
    cloud = PointCloud(frame_id=WORLD_FRAME, point_stride=POINT.itemsize)
    # Rerun treats a pose without a position as invalid.
    cloud.pose.position.SetInParent()
    cloud.pose.orientation.w = 1.0
    for place, name in enumerate(POINT_FLOATS):
        cloud.fields.add(name=name, offset=4 * place, type=PackedElementField.FLOAT32)
    for place, name in enumerate(POINT_COLOURS):
        cloud.fields.add(name=name, offset=4 * len(POINT_FLOATS) + place, type=PackedElementField.UINT8)
    cloud.fields.add(name="status", offset=POINT.itemsize - 1, type=PackedElementField.UINT8)
    points = _Piece(bytes(drones * POINT.itemsize), "points", (POINT, (drones,)))
    return _record(
        _Piece(cloud.SerializeToString()),
        *_message(PointCloud.TIMESTAMP_FIELD_NUMBER, _STAMP),
        *_message(PointCloud.DATA_FIELD_NUMBER, points),
    )


def transforms_record(drones: int) -> WireRecord:
    """`foxglove.FrameTransforms` with the field `drones`: (N,), `stamp`, `translation`, `rotation`."""
    records = [_transform(frame_name(drone, drones)) for drone in range(drones)]
    return WireRecord(
        np.dtype([("drones", records[0].dtype, (drones,))]), b"".join(record.constant for record in records)
    )


def metrics_record() -> WireRecord:
    """`moflock.Metrics` with the fields `values` (order parameters, then fitness), `tick` and `digest`."""
    values = _doubles("values", len(ORDER_PARAMETER_FIELDS) + len(FITNESS_FIELDS))
    tick = _Piece(_tag(Metrics.TICK_FIELD_NUMBER, _VARINT))
    digest = _Piece(bytes(_DIGEST_SIZE), "digest", ("u1", (_DIGEST_SIZE,)))
    number = _Piece(bytes(len(_SEPTETS)), "tick", ("u1", len(_SEPTETS)))
    return _record(values, tick, number, *_message(Metrics.STATE_DIGEST_FIELD_NUMBER, digest))


def varints(values: npt.NDArray[np.int64]) -> npt.NDArray[np.uint8]:
    """Integers below 2**35 as varints, (...) to (..., 5).

    They always take five bytes, which protobuf permits, so that the length of a message is constant.
    """
    septets = (values[..., None] >> _SEPTETS) & 0x7F | _MORE_FOLLOW
    return np.asarray(septets, np.uint8)


def timestamps(time_ns: npt.NDArray[np.int64]) -> npt.NDArray[np.uint8]:
    """Encode simulated times, (K,) ns, as contents of `google.protobuf.Timestamp`, (K, 12)."""
    seconds_nanos = np.empty((len(time_ns), 2), np.int64)
    np.divmod(time_ns, 1_000_000_000, seconds_nanos[:, 0], seconds_nanos[:, 1])
    fields = np.empty((len(time_ns), 2, 6), np.uint8)
    fields[..., 0] = _TIMESTAMP_TAGS
    fields[..., 1:] = varints(seconds_nanos)
    return fields.reshape(-1, 12)


class _Piece(NamedTuple):
    """Part of a message: its bytes, and name and dtype of the field if they vary."""

    constant: bytes
    name: str = ""
    dtype: Any = None


def _record(*pieces: _Piece) -> WireRecord:
    constant = b"".join(piece.constant for piece in pieces)
    starts = np.cumsum([0, *(len(piece.constant) for piece in pieces)])
    fields = [(piece, int(start)) for piece, start in zip(pieces, starts, strict=False) if piece.name]
    names = [piece.name for piece, _ in fields]
    formats = [piece.dtype for piece, _ in fields]
    offsets = [start for _, start in fields]
    dtype = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": len(constant)})
    return WireRecord(dtype, constant)


def _varint(value: int) -> bytes:
    if value < 0x80:
        return bytes([value])
    return bytes([value & 0x7F | 0x80]) + _varint(value >> 7)


def _tag(number: int, wire_type: int) -> bytes:
    return _varint(number << 3 | wire_type)


def _message(number: int, *pieces: _Piece) -> tuple[_Piece, ...]:
    """Field of type bytes or message: tag and length, then the pieces."""
    length = sum(len(piece.constant) for piece in pieces)
    return (_Piece(_tag(number, _BYTES) + _varint(length)), *pieces)


def _doubles(name: str, count: int) -> _Piece:
    """Fields 1 to `count` of a message, all doubles."""
    constant = b"".join(_tag(number, _DOUBLE) + bytes(8) for number in range(1, count + 1))
    return _Piece(constant, name, (_TAGGED_DOUBLE, (count,)))


_STAMP = _Piece(bytes(12), "stamp", ("u1", 12))


def _transform(frame: str) -> WireRecord:
    """Element of /tf, a `foxglove.FrameTransform`."""
    return _record(
        *_message(
            FrameTransforms.TRANSFORMS_FIELD_NUMBER,
            *_message(1, _STAMP),
            *_message(2, _Piece(WORLD_FRAME.encode())),
            *_message(3, _Piece(frame.encode())),
            *_message(4, _doubles("translation", 3)),
            *_message(5, _doubles("rotation", 4)),
        )
    )
