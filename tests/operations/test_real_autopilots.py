"""Real ArduCopter and PX4 programs on our bodies, where there are some.

MOFLOCK_ARDUCOPTER: path of ArduCopter built for simulation. MOFLOCK_PX4: path of the `px4` of a simulation build, in a
folder beside its `etc`.
"""

from __future__ import annotations

import asyncio
import json
import math
import os
import signal
import statistics
import subprocess
from pathlib import Path

import pytest

from moflock_mj.ground_station.commands import set_rates
from moflock_mj.ground_station.flight_modes import DEPLOYMENT_RATES
from moflock_mj.ground_station.piloting import STREAM_FIRST, FlightTask, begin, take_off, velocity_setpoint
from moflock_mj.ground_station.station import vehicles_at
from moflock_mj.mavlink.addresses import parse_vehicles
from moflock_mj.mavlink.dialect import mavlink
from tests.support.cli import MOFLOCK
from tests.support.copter_pilot import CopterPilot

pytestmark = pytest.mark.slow

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


async def fly_px4() -> list[float]:
    """One flight by our own ground station; returns the velocity north, m/s, as it followed 3 m/s.

    PX4 sends to UDP port 14550 by itself.
    """
    async with vehicles_at(parse_vehicles("udpin:127.0.0.1:14550"), timeout=120.0) as (_, (vehicle,)):
        assert await set_rates(vehicle, DEPLOYMENT_RATES) == []

        async def until(condition, what):
            try:
                async with asyncio.timeout(300.0):
                    while not condition():
                        await asyncio.sleep(0.05)
            except TimeoutError:
                pytest.fail(f"not {what}: {vehicle.mode_name}, {vehicle.fix}, {[told.text for told in vehicle.texts]}")

        def can_arm():
            status = vehicle.message("SYS_STATUS")
            return status and status.onboard_control_sensors_health & mavlink.MAV_SYS_STATUS_PREARM_CHECK

        async def stream():
            while True:
                vehicle.send(velocity_setpoint(vehicle.system, tuple(velocity)))
                await asyncio.sleep(0.05)

        await until(lambda: can_arm() and vehicle.fix and vehicle.home(), "ready")
        await take_off(vehicle, 10.0, timeout=60.0)
        await until(lambda: vehicle.mode_name == "HOLD" and vehicle.fix.height > 9.0, "climbed")
        velocity = [0.0, 0.0, 0.0]
        streaming = asyncio.create_task(stream())
        await asyncio.sleep(STREAM_FIRST)
        await begin(vehicle, FlightTask.OBEY, timeout=60.0)
        velocity[1] = 3.0
        await until(lambda: vehicle.velocity[1] > 2.7, "fast")
        north = []
        for _ in range(20):
            await asyncio.sleep(0.1)
            north.append(vehicle.velocity[1])
        await begin(vehicle, FlightTask.HOLD, timeout=60.0)
        streaming.cancel()
        await until(lambda: math.hypot(*vehicle.velocity) < 0.5, "held")
        assert vehicle.fix.height == pytest.approx(10.0, abs=1.5)
        await begin(vehicle, FlightTask.LAND, timeout=60.0)
        await until(lambda: not vehicle.armed and vehicle.landed, "landed")
        return north


def test_a_px4_takes_off_follows_a_velocity_holds_and_lands_in_lock_step(tmp_path):
    px4 = program("MOFLOCK_PX4")
    (tmp_path / "calm.toml").write_text("sigma_outer = 0.0\nsigma_inner = 0.0\n")
    command = f"env PX4_SYS_AUTOSTART=10016 {px4} -i {{instance}} -d {px4.parent.parent / 'etc'}"
    wish = [
        "--physics-for",
        "px4",
        "--vehicles",
        "1",
        "--scenario",
        "calm.toml",
        "--autopilot-command",
        command,
        "--json",
    ]
    moflock = subprocess.Popen([MOFLOCK, "fleet", *wish], cwd=tmp_path, stdout=subprocess.PIPE, text=True)
    try:
        assert json.loads(moflock.stdout.readline())["ports"] == [4560]
        north = asyncio.run(fly_px4())
    finally:
        moflock.send_signal(signal.SIGINT)
        out, _ = moflock.communicate(timeout=30)
    assert sum(north) / len(north) == pytest.approx(3.0, abs=0.3)
    end = json.loads(out)
    assert (end["present"], end["restarts"], end["dropped"]) == (1, 0, 0)
    assert end["received"] == pytest.approx(250 * end["time"], rel=0.02)
