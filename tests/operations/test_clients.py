"""Real ground stations fly the fleet: MAVSDK and MAVProxy, by the connect strings of `moflock fleet --help`."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import os
import re
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from tests.support.cli import BIN
from tests.support.vehicles import free_port, running_fleet

SUPPORT = Path(__file__).parents[1] / "support"
MAVPROXY = BIN / "mavproxy.py"

pytestmark = pytest.mark.slow
needs_mavsdk = pytest.mark.skipif(importlib.util.find_spec("mavsdk") is None, reason="mavsdk is not installed")
needs_mavproxy = pytest.mark.skipif(not MAVPROXY.exists(), reason="MAVProxy is not installed")


@needs_mavsdk
@pytest.mark.parametrize(("autopilot", "kind", "waits"), [("ardupilot", "ARDUPILOT", False), ("px4", "PX4", True)])
def test_mavsdk_flies(tmp_path, autopilot, kind, waits):
    port = free_port()
    to = ("--to", f"127.0.0.1:{port}") if waits else ()
    with running_fleet(tmp_path, "--autopilot", autopilot, "--speed", "2", *to) as endpoints:
        url = f"udpin://127.0.0.1:{port}" if waits else f"udpout://{endpoints['vehicles'][0]['udp']}"
        done = subprocess.run(
            [sys.executable, SUPPORT / "mavsdk_flight.py", url],
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )
    assert done.returncode == 0, done.stdout + done.stderr
    seen = json.loads(done.stdout.splitlines()[-1])
    assert seen["autopilot"] == kind
    assert seen["satellites"] == 12
    assert seen["battery"] > 90
    assert seen["parameters"] > 10
    assert seen["altitude"] == pytest.approx(3.0, abs=0.3)
    assert seen["mode"] == "OFFBOARD"
    assert seen["velocity"] == pytest.approx([2.0, -1.0, 0.0], abs=0.25)
    assert seen["landed"] == "ON_GROUND"


class Proxy:
    """A MAVProxy at its prompt."""

    def __init__(self, master, folder):
        self.told = ""
        self.process = subprocess.Popen(
            [sys.executable, MAVPROXY, "--master", master, "--state-basedir", folder, "--default-modules",
             "signing,cmdlong,fence,mode,param,arm"],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=folder,
            env={**os.environ, "HOME": str(folder)},
        )  # fmt: skip
        self.listener = threading.Thread(target=self._listen)
        self.listener.start()

    def close(self):
        self.process.kill()
        self.listener.join()
        self.process.communicate()

    def _listen(self):
        for line in self.process.stdout:
            self.told += line

    def expect(self, pattern, command=None, seconds=30.0):
        """Give a command, and wait for an answer."""
        before = len(self.told)
        if command is not None:
            self.process.stdin.write(command + "\n")
            self.process.stdin.flush()
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            found = re.search(pattern, self.told[before if command else 0 :])
            if found:
                return found
            time.sleep(0.05)
        raise AssertionError(f"{command}: no {pattern!r} in\n{self.told[before:]}")


@contextlib.contextmanager
def running_proxy(master, folder):
    proxy = Proxy(master, folder)
    try:
        yield proxy
    finally:
        proxy.close()


FENCE = """QGC WPL 110
0\t0\t0\t5001\t4\t0\t0\t0\t47.3970\t8.5440\t0\t1
1\t0\t0\t5001\t4\t0\t0\t0\t47.3970\t8.5470\t0\t1
2\t0\t0\t5001\t4\t0\t0\t0\t47.3985\t8.5470\t0\t1
3\t0\t0\t5001\t4\t0\t0\t0\t47.3985\t8.5440\t0\t1
"""


@needs_mavproxy
def test_mavproxy_flies_ardupilot(tmp_path):
    (tmp_path / "fence.txt").write_text(FENCE)
    with running_fleet(tmp_path, "--speed", "2") as endpoints:
        master = f"udpout:{endpoints['vehicles'][0]['udp']}"
        with running_proxy(master, tmp_path) as proxy:
            proxy.expect(r"Received \d+ parameters", seconds=60)
            proxy.expect(r"FENCE_RADIUS\s+300", "param show FENCE_*")
            proxy.expect(r"(?i)sent all 4 fence items|loaded 4", "fence load fence.txt")
            proxy.expect(r"5001|Polygon", "fence list")
            proxy.expect(r"DO_SET_MODE: ACCEPTED", "mode GUIDED")
            proxy.expect(r"COMPONENT_ARM_DISARM: ACCEPTED", "arm throttle")
            proxy.expect(r"NAV_TAKEOFF: ACCEPTED", "takeoff 3")
            time.sleep(2.0)
            proxy.expect(r"Mode LAND", "mode LAND")
            proxy.expect(r"DISARMED")


@needs_mavproxy
def test_mavproxy_waits_for_px4_and_signs(tmp_path):
    port, key = free_port(), "correct-horse-battery-staple"
    with (
        running_fleet(
            tmp_path, "--autopilot", "px4", "--to", f"127.0.0.1:{port}", "--speed", "2", key=key
        ) as endpoints,
        running_proxy(f"udpin:127.0.0.1:{port}", tmp_path) as proxy,
    ):
        assert endpoints["signed"]
        proxy.expect(r"Detected vehicle 1:1", seconds=60)
        proxy.expect(r"Setup signing", f"signing key {key}")
        proxy.expect(r"Received \d+ parameters", "param fetch", seconds=60)
        proxy.expect(r"MPC_XY_VEL_MAX\s+12", "param show MPC_XY*")
        proxy.expect(r"COMPONENT_ARM_DISARM: ACCEPTED", "arm throttle")
        proxy.expect(r"DISARMED")
