"""Programs of autopilots: their commands, their folders, their end."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from moflock_mj.errors import FleetError
from moflock_mj.sitl.processes import PLACEHOLDERS, Processes, fill_command
from tests.support.waiting import wait_until

VALUES = {name: name.upper() for name in PLACEHOLDERS}


def test_a_command_is_split_as_by_a_shell_and_filled():
    words = fill_command("env A='b c' copter -I{instance} --home {home} --sysid={sysid} \"{here}/x y\"", VALUES)
    assert words == ["env", "A=b c", "copter", "-IINSTANCE", "--home", "HOME", "--sysid=SYSID", "HERE/x y"]


def test_a_relative_program_is_where_moflock_was_started(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "copter").symlink_to("/bin/true")
    assert fill_command("bin/copter -I0", VALUES)[0] == str(tmp_path / "bin" / "copter")


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("", "it is empty"),
        ("copter '", "No closing quotation"),
        ("copter {model}", "placeholder 'model' is unknown: there are instance, sysid, port, home, speed, here"),
        ("copter {0}", "autopilot-command: "),
        ("copter {", "autopilot-command: "),
    ],
)
def test_a_bad_command(command, words):
    with pytest.raises(FleetError, match=words):
        fill_command(command, VALUES)


def alive(pid):
    """Whether a process runs, and is no zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


STUBBORN = """
import os, signal, subprocess, sys, time
signal.signal(signal.SIGTERM, signal.SIG_IGN)
child = subprocess.Popen([sys.executable, "-c", "import signal, time; signal.signal(15, 1); time.sleep(600)"])
print(os.getcwd(), os.getpid(), child.pid, flush=True)
time.sleep(600)
"""


def test_programs_have_folders_and_end_with_their_children_even_if_they_do_not_want_to(tmp_path, monkeypatch):
    monkeypatch.setattr("moflock_mj.sitl.processes._GRACE", 0.2)
    outputs = [tmp_path / str(number) / "output.txt" for number in range(2)]
    with Processes([[sys.executable, "-c", STUBBORN]] * 2, tmp_path) as programs:
        wait_until(lambda: all(path.exists() and path.read_text().endswith("\n") for path in outputs))
        printed = [path.read_text().split() for path in outputs]
        pids = [int(pid) for _, *both in printed for pid in both]
        assert all(map(alive, pids))
        assert programs.ended(0) is None
    assert [Path(folder) for folder, *_ in printed] == [tmp_path / "0", tmp_path / "1"]
    wait_until(lambda: not any(map(alive, pids)))


def test_a_second_ctrl_c_while_programs_end_leaves_none(tmp_path, monkeypatch):
    program = [sys.executable, "-c", "import signal, time; signal.signal(15, 1); print(1, flush=True); time.sleep(600)"]
    programs = Processes([program], tmp_path)
    wait_until((tmp_path / "0" / "output.txt").read_text)
    naps = iter([KeyboardInterrupt])

    def nap(_):
        for interrupt in naps:
            raise interrupt

    with monkeypatch.context() as patch:
        patch.setattr("moflock_mj.sitl.processes.time.sleep", nap)
        with pytest.raises(KeyboardInterrupt):
            programs.end()
    assert programs.ended(0) == f"it has ended with signal 9: see {tmp_path / '0' / 'output.txt'}"


def test_how_a_program_has_ended(tmp_path):
    with Processes([[sys.executable, "-c", "print('no'); raise SystemExit(3)"]], tmp_path) as programs:
        wait_until(lambda: programs.ended(0) is not None)
        assert programs.ended(0) == f"it has ended with status 3: see {tmp_path / '0' / 'output.txt'}"
    assert (tmp_path / "0" / "output.txt").read_text() == "no\n"


def test_a_program_that_is_not_there_leaves_none_running(tmp_path):
    started = tmp_path / "started"
    writes = f"import os, time; open({str(started)!r}, 'w').write(str(os.getpid())); time.sleep(600)"
    with pytest.raises(FleetError, match="autopilot-command: /nowhere/copter: No such file or directory"):
        Processes([[sys.executable, "-c", writes], ["/nowhere/copter"]], tmp_path)
    assert not started.exists() or not alive(int(started.read_text() or os.getpid()))
