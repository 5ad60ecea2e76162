"""Fuzzing of an endpoint: `python -m tests.support.fuzzing 10000000` sends as many bytes to each autopilot."""

from __future__ import annotations

import inspect
import itertools
import random
import sys
import time
import tracemalloc

from moflock_mj.mavlink.dialect import mavlink
from moflock_mj.mavlink.endpoint import Endpoint
from moflock_mj.mavlink.signing import SigningKey
from moflock_mj.simulated_vehicles.fleet import AUTOPILOTS, Fleet, FleetPlan
from tests.support.ground_station import GroundStation

_ATTACKER = ("10.0.0.1", 666)
_SIZES = {"double": 8, "float": 4}
_SIZES |= {f"{sign}int{bits}_t": bits // 8 for sign in ("", "u") for bits in (8, 16, 32, 64)}
_FLOATS, _TEXTS = ("float", "double"), ("char",)


def corpus(target, value=0.0):
    """One message of each type of the dialect; floats are `value`, targets `target`, other fields 0 or 1."""
    messages = []
    for kind in mavlink.mavlink_map.values():
        arguments = []
        names = [name for name in inspect.signature(kind.__init__).parameters if name != "self"]
        types = dict(zip(kind.fieldnames, kind.fieldtypes, strict=True))
        lengths = dict(zip(kind.ordered_fieldnames, kind.array_lengths, strict=True))
        for name in names:
            field, length = types[name], lengths[name]
            if field in _TEXTS:
                arguments.append(b"x")
                continue
            one = value if field in _FLOATS else target if name == "target_system" else 1
            arguments.append([one] * length if length else one)
        message = kind(*arguments)
        try:
            message.pack(mavlink.MAVLink(None))
        except Exception as error:  # an error of the library or of this corpus, not of the endpoint
            raise AssertionError(kind.msgname) from error
        messages.append(message)
    return messages


def changeable_state(vehicle):
    """State of a vehicle that a message can change."""
    parameters = vehicle.parameters
    names = [parameters.name(index) for index in range(len(parameters))]
    return (
        vehicle.mode,
        vehicle.armed,
        vehicle.phase,
        vehicle.home,
        vehicle.setpoint,
        vehicle.ground_heartbeat,
        [(name, parameters[name]) for name in names],
        tuple(vehicle.fence.items),
        vehicle.shapes,
        vehicle.fence._upload,
        tuple(vehicle.outbox),
    )


def _target_offsets(kind):
    """Offsets of the targets in a message's payload, bytes."""
    types = dict(zip(kind.fieldnames, kind.fieldtypes, strict=True))
    at, offsets = 0, []
    for name, length in zip(kind.ordered_fieldnames, kind.array_lengths, strict=True):
        if name in ("target_system", "target_component"):
            offsets.append(at)
        at += _SIZES.get(types[name], 1) * max(length, 1)
    assert at == kind.unpacker.size, kind.msgname
    return offsets


class Fuzzer:
    """Generator of hostile bytes for an endpoint, deterministic in its seed."""

    def __init__(self, endpoint, seed):
        self.endpoint = endpoint
        self.rng = random.Random(seed)
        sender = Endpoint(255, lambda *_: None, component=190)
        peer = sender.peer(_ATTACKER)
        self.packets = [sender.pack(message, peer) for message in corpus(target=1)]

    def random_bytes(self, count):
        """Send datagrams of random bytes; half of them begin like a packet."""
        while count > 0:
            data = bytearray(self.rng.randbytes(self.rng.randint(1, 267)))
            if self.rng.random() < 0.5:
                data[0] = 0xFD
            if len(data) > 12 and self.rng.random() < 0.5:
                data[1], data[2] = len(data) - 12, 0
            self.endpoint.datagram_received(bytes(data), _ATTACKER)
            count -= len(data)

    def mutated_bytes(self, count):
        """Send corrupted packets: bytes changed, truncated, flipped or inserted; never an intact packet."""
        while count > 0:
            packet = self.rng.choice(self.packets)
            data, kind = bytearray(packet), self.rng.randrange(4)
            if kind == 0:
                for _ in range(self.rng.randint(1, 4)):
                    data[self.rng.randrange(len(data))] ^= self.rng.randint(1, 255)
            elif kind == 1:
                del data[self.rng.randrange(1, len(data)) :]
            elif kind == 2:
                data[self.rng.randrange(len(data))] ^= 1 << self.rng.randrange(8)
            else:
                at = self.rng.randrange(1, len(data))
                data[at:at] = self.rng.randbytes(self.rng.randint(1, 8))
            if not data.startswith(packet):
                self.endpoint.datagram_received(bytes(data), _ATTACKER)
                count -= len(data)

    def valid_packets(self, count):
        """Send packets of random type, content and length with correct checksums; some are for this vehicle."""
        kinds = list(mavlink.mavlink_map.values())
        for number in range(count):
            kind, payload = self.rng.choice(kinds), bytearray(self.rng.randbytes(self.rng.randint(1, 255)))
            header = bytes((len(payload), 0, 0, number % 256, 255, 190, *kind.id.to_bytes(3, "little")))
            for at in _target_offsets(kind):
                if at < len(payload):
                    payload[at] = self.rng.choice((0, 1, 1, 1, 7))
            checksum = mavlink.x25crc(header + payload + bytes([kind.crc_extra])).crc
            packet = b"\xfd" + header + bytes(payload) + checksum.to_bytes(2, "little")
            self.endpoint.datagram_received(packet, _ATTACKER)


def main():
    count = int(sys.argv[1])
    keys = (None, SigningKey(bytes(range(32))))
    for autopilot, key in itertools.product(sorted(AUTOPILOTS), keys):
        station = GroundStation(Fleet(FleetPlan(autopilot=autopilot, boot=0.0), key), key=key)
        state = changeable_state(station.vehicle)
        fuzzer = Fuzzer(station.station.endpoint, seed=7)
        fuzzer.random_bytes(100_000)
        tracemalloc.start()
        before, _ = tracemalloc.get_traced_memory()
        began = time.process_time()
        fuzzer.random_bytes(count // 2)
        fuzzer.mutated_bytes(count // 2)
        seconds = time.process_time() - began
        after, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        changed = changeable_state(station.vehicle) != state
        fuzzer.valid_packets(count // 200)
        station.wait(1.0)
        print(
            f"{autopilot}, {'signed' if key else 'unsigned'}: {count} bytes in {seconds:.0f} s CPU, "
            f"{station.station.endpoint.counts}, state {'CHANGED' if changed else 'unchanged'}, "
            f"memory {after - before:+d} bytes, peak {peak - before:+d}",
            flush=True,
        )


if __name__ == "__main__":
    main()
