"""Simulated vehicles in programs of their own, free ports for them, and their failsafes."""

from __future__ import annotations

import contextlib
import json
import signal
import socket

from moflock_mj.mavlink.signing import KEY_VARIABLE
from tests.support.cli import environment_of, start_program

CALM = "sigma_outer = 0.0\nsigma_inner = 0.0\n"

FAILSAFES = {
    "ardupilot": {"FS_GCS_ENABLE": 5, "LAND_SPEED": 100},
    "px4": {"NAV_DLL_ACT": 3, "COM_OBL_RC_ACT": 5, "MPC_LAND_SPEED": 1.0},
}
"""On the loss of the ground station: land; of PX4's stream: hold."""


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def free_ports(count):
    """The first of some ports in a row that nobody uses."""
    for first in range(20_000, 30_000, count):
        probes = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(count)]
        try:
            for number, probe in enumerate(probes):
                probe.bind(("127.0.0.1", first + number))
        except OSError:
            continue
        else:
            return first
        finally:
            for probe in probes:
                probe.close()
    raise AssertionError("no ports")


@contextlib.contextmanager
def running_fleet(folder, *arguments, key=None):
    """A fleet in a process of its own; yields its endpoints as it prints them."""
    (folder / "calm.toml").write_text(CALM)
    command = ("fleet", "--base-port", "0", "--boot", "3", "--json", "--scenario", "calm.toml", "--vehicles", "1")
    fleet = start_program(*command, *arguments, cwd=folder, env=environment_of({KEY_VARIABLE: key} if key else {}))
    try:
        line = fleet.stdout.readline()
        assert line, fleet.stderr.read()
        yield json.loads(line)
    finally:
        fleet.send_signal(signal.SIGTERM)
        stdout, stderr = fleet.communicate(timeout=60)
    assert fleet.returncode == 0, stderr
    if key is None:  # else the client may have spoken before it knew the key
        assert json.loads(stdout)["dropped"] == 0
    assert stderr == ""
