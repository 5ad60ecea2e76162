"""An endpoint delivers what is whole, authentic and addressed to it, and counts the rest."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from moflock_mj.errors import LinkError
from moflock_mj.mavlink.dialect import mavlink
from moflock_mj.mavlink.endpoint import PEERS_MAX, Endpoint
from moflock_mj.mavlink.signing import KEY_VARIABLE, SigningClock, SigningKey, find_key

KEY = SigningKey(bytes(range(32)))
OTHER_KEY = SigningKey(bytes(32))
HERE, THERE = ("127.0.0.1", 1), ("127.0.0.1", 2)


def heartbeat():
    return mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)


def ping(system, component=0):
    return mavlink.MAVLink_ping_message(1, 2, system, component)


class Pair:
    """A vehicle's endpoint and a ground station's, and what the vehicle receives."""

    def __init__(self, key=None, station_key=None, station=255, clock=None):
        self.told = []
        self.vehicle = Endpoint(1, lambda message, _: self.told.append(message), key=key, clock=clock)
        self.station = Endpoint(station, lambda *_: None, component=190, key=station_key, clock=clock)
        self.peer = self.station.peer(HERE)

    def packet(self, message):
        return self.station.pack(message, self.peer)

    def give(self, packet, address=THERE):
        self.vehicle.datagram_received(packet, address)
        return len(self.told)


def test_a_packet_arrives_and_its_sender_becomes_a_peer():
    pair = Pair()
    assert pair.give(pair.packet(heartbeat())) == 1
    assert list(pair.vehicle.peers) == [THERE]
    assert pair.vehicle.counts.received == 1


def test_several_packets_in_a_datagram_arrive():
    pair = Pair()
    assert pair.give(pair.packet(heartbeat()) + pair.packet(ping(1)) + pair.packet(ping(0))) == 3


@pytest.mark.parametrize(
    "spoil",
    [
        lambda _: b"",
        lambda packet: packet[:-1],
        lambda packet: packet[1:],
        lambda packet: packet[:11],
        lambda packet: b"\xfe" + packet[1:],  # MAVLink 1
        lambda packet: packet[:12] + bytes([packet[12] ^ 1]) + packet[13:],
        lambda packet: packet[:2] + b"\x02" + packet[3:],  # an unknown flag that must be understood
    ],
)
def test_what_is_malformed_is_counted_and_leaves_no_peer(spoil):
    pair = Pair()
    packet = spoil(pair.packet(heartbeat()))
    assert pair.give(packet) == 0
    assert pair.vehicle.counts.malformed == (1 if packet else 0)
    assert not pair.vehicle.peers


def unheard_of(packet):
    """The packet as one of a kind that no dialect has; its checksum cannot be checked."""
    return packet[:7] + b"\xff\xff\xff" + packet[10:]


def test_a_kind_of_message_that_newer_firmware_has_is_neither_malformed_nor_lost():
    """PX4 1.17 sends six of them, 6 packets of 300 a second."""
    pair = Pair()
    pair.give(unheard_of(pair.packet(heartbeat())))
    assert not pair.vehicle.peers
    for number in range(1, 20):
        packet = pair.packet(heartbeat())
        pair.give(unheard_of(packet) if number % 3 else packet)
    counts = pair.vehicle.counts
    assert (len(pair.told), counts.unknown, counts.malformed, counts.lost) == (6, 14, 0, 0)


def test_what_cannot_be_checked_does_not_move_a_sequence():
    pair = Pair()
    pair.give(pair.packet(heartbeat()))
    forged = unheard_of(pair.packet(heartbeat()))
    pair.give(forged[:4] + bytes([77]) + forged[5:])
    pair.give(pair.packet(heartbeat()))
    assert pair.vehicle.counts.lost == 1


@pytest.mark.parametrize("target", [(2, 1), (1, 100), (255, 0)])
def test_what_is_addressed_to_others_is_foreign(target):
    pair = Pair()
    assert pair.give(pair.packet(ping(*target))) == 0
    assert pair.vehicle.counts.foreign == 1
    assert not pair.vehicle.peers


def test_what_comes_in_our_own_name_is_foreign():
    pair = Pair(station=1)
    pair.station.component = 1
    pair.peer = pair.station.peer(("127.0.0.1", 3))
    assert pair.give(pair.packet(heartbeat())) == 0
    assert pair.vehicle.counts.foreign == 1


def test_gaps_in_the_sequence_are_counted_and_a_restart_is_not():
    pair = Pair()
    packets = [pair.packet(heartbeat()) for _ in range(300)]
    for number in (0, 1, 5, 6, 250, 260):
        pair.give(packets[number])
    assert pair.vehicle.counts.lost == 3 + 9  # 244 missing look like a sender that began anew
    assert pair.give(packets[3]) == 7


def test_peers_do_not_pile_up():
    pair = Pair()
    for port in range(1, 5 * PEERS_MAX):
        pair.give(pair.packet(heartbeat()), ("127.0.0.1", port))
    assert len(pair.vehicle.peers) == PEERS_MAX
    assert ("127.0.0.1", 5 * PEERS_MAX - 1) in pair.vehicle.peers


def test_signed_links_take_only_what_is_signed_with_their_key():
    for station_key, taken in ((KEY, 1), (OTHER_KEY, 0), (None, 0)):
        pair = Pair(KEY, station_key)
        assert pair.give(pair.packet(heartbeat())) == taken
        assert pair.vehicle.counts.unsigned == 1 - taken


def test_an_unsigned_link_understands_who_signs():
    pair = Pair(None, KEY)
    assert pair.give(pair.packet(heartbeat())) == 1


def test_a_message_nobody_knows_does_not_pass_a_signed_link():
    pair = Pair(KEY, KEY)
    assert pair.give(unheard_of(pair.packet(heartbeat()))) == 0
    assert (pair.vehicle.counts.unknown, pair.vehicle.counts.unsigned) == (0, 1)


def test_a_packet_is_taken_once_even_from_another_port():
    pair = Pair(KEY, KEY)
    packet = pair.packet(heartbeat())
    assert pair.give(packet) == 1
    assert pair.give(packet) == 1
    assert pair.give(packet, ("127.0.0.1", 9)) == 1
    assert pair.vehicle.counts.unsigned == 2


def test_a_forged_packet_from_the_future_does_not_block_the_sender():
    pair = Pair(KEY, KEY)
    assert pair.give(pair.packet(heartbeat())) == 1
    forged = bytearray(pair.packet(heartbeat()))
    forged[-12:-6] = b"\xff" * 6
    assert pair.give(bytes(forged)) == 1
    assert pair.give(pair.packet(heartbeat())) == 2


def test_a_recording_of_yesterday_is_refused_and_so_is_the_day_after_tomorrow():
    now = [2e9]
    clock = SigningClock(lambda: now[0])
    pair = Pair(KEY, KEY, clock=clock)
    packet = pair.packet(heartbeat())
    now[0] += 61
    assert pair.give(packet) == 0
    ahead = Pair(KEY, KEY, clock=SigningClock(lambda: 2e9 + 2 * 86_400))
    assert pair.give(ahead.packet(heartbeat())) == 0
    assert pair.give(pair.packet(heartbeat())) == 1


def test_all_links_share_one_clock_that_never_stands_still():
    clock = SigningClock(lambda: 2e9)
    first, second = Pair(KEY, KEY, clock=clock), Pair(KEY, KEY, clock=clock)
    packets = [pair.packet(heartbeat()) for pair in (first, second, first, second)]
    times = [int.from_bytes(packet[-12:-6], "little") for packet in packets]
    assert times == sorted(set(times))


def test_pymavlink_itself_accepts_what_we_sign():
    pair = Pair(None, KEY)
    theirs = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    theirs.signing.secret_key = KEY.secret
    assert theirs.decode(bytearray(pair.packet(heartbeat()))).get_signed()


def test_a_key_is_read_from_a_file_of_ones_own(tmp_path):
    path = tmp_path / "key"
    path.write_text(KEY.secret.hex() + "\n")
    path.chmod(0o600)
    assert find_key(path).secret == KEY.secret
    path.chmod(0o640)
    with pytest.raises(LinkError, match="permissions 640: they must be 600"):
        find_key(path)
    with pytest.raises(LinkError, match="No such file"):
        find_key(tmp_path / "absent")
    with pytest.raises(LinkError, match="regular"):
        find_key(Path("/dev/null"))
    os.mkfifo(tmp_path / "pipe", 0o600)
    with pytest.raises(LinkError, match="regular"):
        find_key(tmp_path / "pipe")
    short = tmp_path / "short"
    short.write_text("secret")
    short.chmod(0o600)
    with pytest.raises(LinkError, match="6 characters: it must have at least 8"):
        find_key(short)


def test_a_key_is_read_from_the_environment(monkeypatch):
    monkeypatch.delenv(KEY_VARIABLE, raising=False)
    assert find_key(None) is None
    monkeypatch.setenv(KEY_VARIABLE, "correct horse battery staple")
    assert len(find_key(None).secret) == 32
    assert "horse" not in repr(find_key(None))
