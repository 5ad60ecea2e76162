"""Broken logs: killed writers, cuts, flipped bits, and files made to do harm."""

from __future__ import annotations

import io
import signal
import subprocess
import sys
import time
import tracemalloc

import numpy as np
import pytest
from mcap.reader import make_reader

from moflock_mj import read_log
from moflock_mj.analysis.verification import verify
from moflock_mj.cli.replay_output import print_logged_flight, print_recovery, print_verification
from moflock_mj.errors import LogError
from moflock_mj.log.recovery import RECOVERY_METADATA, recover, recovered_path
from moflock_mj.log.schemas import RUN_COPY
from tests.support.logs import bomb, foreign

ROUNDS = 200


@pytest.fixture(scope="module")
def original(small_log):
    return read_log(small_log)


def check_part_of(original, path):
    """A log that can be read tells nothing but the truth, and returns how many of its samples it has."""
    logged = read_log(path)
    for name in ("params", "scenario", "dynamics", "seed"):
        assert getattr(logged, name) == getattr(original, name)
    places = np.searchsorted(original.samples.t, logged.samples.t)
    np.testing.assert_array_equal(logged.samples.t, original.samples.t[places])
    np.testing.assert_array_equal(logged.samples.position, original.samples.position[places])
    np.testing.assert_array_equal(logged.digests, original.digests[places])
    for name, content in logged.attachments.items():
        assert content == original.attachments[name]
    return len(places)


def test_a_sound_log_is_kept_whole(small_log, original, tmp_path):
    told = []
    recovery = recover(small_log, tmp_path / "a.mcap", progress=told.append)
    assert (recovery.kept, recovery.lost, recovery.end, recovery.problems) == (12.0, 0.0, 12.0, ())
    assert recovery.end_known
    assert check_part_of(original, tmp_path / "a.mcap") == 121
    again = read_log(tmp_path / "a.mcap")
    assert (again.states, again.result, again.metadata) == (original.states, original.result, original.metadata)
    assert again.attachments == original.attachments
    assert told == sorted(told)
    assert told[-1] <= 1
    assert recover(tmp_path / "a.mcap", tmp_path / "b.mcap").messages == recovery.messages


def cut(content, rng):
    return content[: rng.integers(len(content))]


def flip(content, rng):
    flipped = bytearray(content)
    flipped[rng.integers(len(content))] ^= 1 << int(rng.integers(8))
    return flipped


def outcome(function, *arguments):
    """What a function returns, or the one line by which it refuses."""
    try:
        return function(*arguments)
    except LogError as refusal:
        return str(refusal)


def test_random_cuts(small_log, original, tmp_path):
    path, out, rng = tmp_path / "cut.mcap.part", tmp_path / "out.mcap", np.random.default_rng(1)
    kept = {}
    for _ in range(ROUNDS):
        path.write_bytes(cut(small_log.read_bytes(), rng))
        read, recovery = outcome(read_log, path), outcome(recover, path, out)
        assert "cut off" in read or "is empty" in read or "not an MCAP" in read
        kept[path.stat().st_size] = 0
        if isinstance(recovery, str):
            assert "\n" not in recovery
            assert not out.exists()
            continue
        kept[path.stat().st_size] = samples = check_part_of(original, out)
        assert recovery.kept == pytest.approx((samples - 1) * 0.1)
        out.unlink()
    assert [kept[size] for size in sorted(kept)] == sorted(kept.values())
    assert max(kept.values()) > 100
    assert list(tmp_path.iterdir()) == [path]


def test_random_flips(small_log, original, tmp_path):
    path, out, rng = tmp_path / "flip.mcap", tmp_path / "out.mcap", np.random.default_rng(2)
    whole = 0
    for _ in range(ROUNDS):
        path.write_bytes(flip(small_log.read_bytes(), rng))
        read = outcome(read_log, path)
        if isinstance(read, str):
            assert "\n" not in read
        else:
            assert check_part_of(original, path) == 121
            whole += 1
        recover(path, out)
        # A flipped bit costs one chunk at most, which is a second; the first one also holds the start.
        assert check_part_of(original, out) >= 110
    assert whole < ROUNDS / 2


@pytest.mark.parametrize("harm", [cut, flip])
def test_broken_logs_take_no_memory(small_log, tmp_path, harm):
    path, rng = tmp_path / "broken.mcap", np.random.default_rng(3)
    tracemalloc.start()
    for _ in range(20):
        path.write_bytes(harm(small_log.read_bytes(), rng))
        outcome(read_log, path)
        outcome(recover, path, tmp_path / "out.mcap")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 20 << 20


def test_a_damaged_second_is_left_out_and_reported(small_log, original, tmp_path, capsys):
    content = bytearray(small_log.read_bytes())
    chunks = [place for place in range(len(content)) if content[place : place + 8] == b"\x04\0\0\0zstd"]
    content[chunks[5] + 100] ^= 1
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    recovery = recover(path)
    assert recovery.log == tmp_path / "a.recovered.mcap"
    assert (recovery.kept, recovery.lost, recovery.end) == (11.0, 1.0, 12.0)
    assert len(recovery.problems) == 1
    logged = read_log(recovery.log)
    assert logged.missing == 1.0
    assert logged.attachments == original.attachments
    verification = verify(read_log(recovery.log))
    assert verification.identical
    assert verification.ticks == 111
    for as_json in (False, True):
        print_recovery(recovery, as_json=as_json)
        print_logged_flight(logged, as_json=as_json)
        print_verification(verification, as_json=as_json)
    text = capsys.readouterr().out
    for words in ("lost: 1 s", "lost: 1 s", "bit-identical: 111 samples", '"identical": true'):
        assert words in text


def test_the_run_is_taken_from_its_copy(small_log, original, tmp_path):
    content = small_log.read_bytes()
    path = tmp_path / "a.mcap"
    for place in (content.index(b"moflock.run"), content.index(b"seed") + 8, content.index(b"parameters") - 4):
        flipped = bytearray(content)
        flipped[place] ^= 1
        path.write_bytes(flipped)
        recover(path, tmp_path / "b.mcap")
        assert check_part_of(original, tmp_path / "b.mcap") == 121
        assert read_log(tmp_path / "b.mcap").metadata == original.metadata


def test_a_lost_attachment_is_reported(small_log, original, tmp_path):
    content = bytearray(small_log.read_bytes())
    content[content.index(b"<mujoco")] ^= 1
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    recovery = recover(path, tmp_path / "b.mcap")
    assert "the checksum of the attachment flock.xml is wrong" in recovery.problems[0]
    assert recovery.lost == 0
    assert set(original.attachments) - set(read_log(tmp_path / "b.mcap").attachments) == {"flock.xml"}


PROGRAM = """
import sys
from moflock_mj import Scenario, fly, load_point
def told(t, _):
    print(t, flush=True)
fly(load_point("A"), scenario=Scenario(duration=3000.0), log=sys.argv[1], keep_samples=False, progress=told)
"""


@pytest.mark.slow
@pytest.mark.parametrize("moment", [0.0, 0.013, 0.2])
def test_a_killed_flight_loses_at_most_its_last_second(tmp_path, moment):
    log, part = tmp_path / "a.mcap", tmp_path / "a.mcap.part"
    with subprocess.Popen([sys.executable, "-c", PROGRAM, log], stdout=subprocess.PIPE, text=True) as flight:
        flown = [float(flight.stdout.readline()) for _ in range(3)]
        time.sleep(moment)
        with pytest.raises(LogError, match="a flight is writing it"):
            recover(part)
        flight.send_signal(signal.SIGKILL)
        flown += [float(line) for line in flight.stdout]
    recovery = recover(part)
    assert recovery.log == log
    assert recovery.kept >= flown[-1] - 1
    assert recovery.lost == 0
    assert not recovery.end_known
    assert read_log(log).attachments.keys() >= {"flock.xml", RUN_COPY}
    assert verify(read_log(log)).identical


def test_files_without_a_flight_are_refused(tmp_path):
    out, path = tmp_path / "out.mcap", tmp_path / "a.mcap"
    foreign(tmp_path / "foreign.mcap")
    bomb(tmp_path / "bomb.mcap", 65 << 20)
    path.write_bytes(b"nothing of use" * 99)
    for broken in (path, tmp_path / "foreign.mcap", tmp_path / "bomb.mcap", tmp_path / "none.mcap", tmp_path):
        with pytest.raises(LogError, match=f"^log: {broken}: ") as refusal:
            recover(broken, out)
        assert "\n" not in str(refusal.value)
        assert not out.exists()
        assert not list(tmp_path.glob("*.part"))


def test_files_made_to_be_slow_are_given_up(small_log, tmp_path):
    content = small_log.read_bytes()
    path = tmp_path / "a.mcap"
    # Thousands of attachments, each of which claims all the rest of the file.
    size = 43 * 40_000
    heads = io.BytesIO()
    for place in range(0, size - 60, 43):
        rest = size - place
        heads.write(b"\x09" + (rest - 9).to_bytes(8, "little") + bytes(16) + bytes(8))
        heads.write((rest - 9 - 36).to_bytes(8, "little") + b"ab")
    path.write_bytes(content[:30_000] + heads.getvalue())
    began = time.perf_counter()
    with pytest.raises(LogError):
        recover(path, tmp_path / "out.mcap")
    assert time.perf_counter() - began < 10


def test_what_cannot_be_written_is_one_line(small_log, tmp_path):
    (tmp_path / "file").touch()
    (tmp_path / "folder").mkdir()
    for out in (tmp_path / "file" / "a.mcap", tmp_path / "folder"):
        with pytest.raises(LogError, match=f"^log: {out}: "):
            recover(small_log, out)
    with pytest.raises(LogError, match="is the broken log"):
        recover(small_log, small_log)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "folder"]


def test_a_recovered_log_lies_beside_the_broken_one(tmp_path):
    assert recovered_path(tmp_path / "a.mcap.part") == tmp_path / "a.mcap"
    (tmp_path / "a.mcap").touch()
    assert recovered_path(tmp_path / "a.mcap.part") == tmp_path / "a.recovered.mcap"
    assert recovered_path(tmp_path / "a.mcap") == tmp_path / "a.recovered.mcap"


def test_a_recovered_log_says_so(small_log, tmp_path):
    recover(small_log, tmp_path / "a.mcap")
    with (tmp_path / "a.mcap").open("rb") as stream:
        records = {record.name: record.metadata for record in make_reader(stream, validate_crcs=True).iter_metadata()}
    assert records[RECOVERY_METADATA] == {"from": "small.mcap", "problems": ""}
