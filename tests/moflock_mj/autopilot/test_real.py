"""Real ArduCopter and PX4 programs on our bodies, where there are some.

MOFLOCK_ARDUCOPTER: path of ArduCopter built for simulation. MOFLOCK_PX4: path of the `px4` of a simulation build, in a
folder beside its `etc`.
"""

from __future__ import annotations

import json
import os
import signal
import statistics
import subprocess
import sys
from pathlib import Path

import pytest

from tests.moflock_mj.autopilot.copter_pilot import CopterPilot

MOFLOCK = Path(sys.executable).parent / "moflock"
QUAD_X = "FRAME_CLASS 1\nFRAME_TYPE 1\nFS_THR_ENABLE 0\n"


def program(variable):
    """The program that a variable of the environment names."""
    path = os.environ.get(variable)
    if not path:
        pytest.skip(f"{variable} names no program: there is nothing real to fly")
    return Path(path).absolute()


@pytest.mark.parametrize("vehicles", [1, 3])
def test_arducopters_take_off_hold_follow_a_velocity_and_land(vehicles, tmp_path):
    (tmp_path / "quad.parm").write_text(QUAD_X)
    command = (
        f"{program('MOFLOCK_ARDUCOPTER')} --model JSON:127.0.0.1 -I{{instance}} --sysid {{sysid}} --home {{home}} "
        f"--defaults {{here}}/quad.parm"
    )
    wish = ["--physics-for", "ardupilot", "--vehicles", str(vehicles), "--autopilot-command", command, "--json"]
    moflock = subprocess.Popen([MOFLOCK, "fleet", *wish], cwd=tmp_path, stdout=subprocess.PIPE, text=True)
    pilots = []
    try:
        assert json.loads(moflock.stdout.readline())["ports"][0] == 9002
        for number in range(vehicles):
            pilots.append(CopterPilot(5760 + 10 * number, number + 1))
        for pilot in pilots:
            pilot.wait_until_ready()
        for pilot in pilots:
            pilot.take_off(10.0)
        for pilot in pilots:
            pilot.until(lambda pilot=pilot: pilot.height() > 9.5, 180.0, "climbing")
        for pilot in pilots:
            held = pilot.pump(5.0)
            assert max(abs(-place.z - 10.0) for place in held) < 1.0
            moved = pilot.fly_velocity(3.0, 0.0, 5.0)
            # The outer noise shakes it by some 0.3 m/s.
            assert statistics.mean(place.vx for place in moved[len(moved) // 2 :]) == pytest.approx(3.0, abs=0.5)
            pilot.land()
        for pilot in pilots:
            pilot.until(lambda pilot=pilot: not pilot.armed(), 180.0, "landing")
    finally:
        for pilot in pilots:
            pilot.close()
        moflock.send_signal(signal.SIGINT)
        out, _ = moflock.communicate(timeout=30)
    end = json.loads(out)
    assert (end["present"], end["restarts"]) == (vehicles, 0)


def test_a_px4_is_in_lock_step(tmp_path):
    px4 = program("MOFLOCK_PX4")
    command = f"env PX4_SYS_AUTOSTART=10016 {px4} -i {{instance}} -d {px4.parent.parent / 'etc'}"
    wish = ["--physics-for", "px4", "--autopilot-command", command, "--json", "--duration", "20"]
    done = subprocess.run(
        [MOFLOCK, "fleet", *wish], cwd=tmp_path, capture_output=True, text=True, timeout=300, check=True
    )
    end = json.loads(done.stdout.splitlines()[-1])
    assert end["present"] == 1
    assert end["received"] > 0.5 * 20 * 250
