"""The program as a whole: its help, its exit statuses, and what it loads."""

from __future__ import annotations

import subprocess
import sys

import pytest

from moflock_mj.cli.app import make_app
from tests.support.cli import MOFLOCK, environment_of, line_of_refusal, run, run_program

HEAVY = ("numpy", "numba", "mujoco", "scipy", "matplotlib")


def names_of_commands():
    app = make_app()
    groups = [app, *(group.typer_instance for group in app.registered_groups)]
    commands = [command for group in groups for command in group.registered_commands]
    return sorted(command.name or command.callback.__name__ for command in commands)


def test_the_commands_are_those_of_the_project():
    assert {"deploy", "fleet", "fly", "optimize", "pca", "preflight", "replay", "validate"} <= set(names_of_commands())


@pytest.mark.parametrize("command", names_of_commands())
def test_help_names_each_command_and_shows_an_example_of_it(command):
    assert command in run("--help").stdout
    assert f"Example: moflock {command}" in run(command, "--help").stdout


def test_help_is_what_a_program_without_arguments_prints():
    done = run_program()
    assert (done.returncode, done.stderr) == (0, "")
    usage, _, rest = done.stdout.partition("\n")
    assert usage.startswith("Usage: moflock ")
    assert rest == run("--help").stdout.partition("\n")[2]  # its first line names the program that runs it


@pytest.mark.parametrize("module", ["moflock_mj", "moflock_mj.cli.app"])
def test_an_import_loads_nothing_heavy(module):
    """So that `moflock --help` waits for no numerics."""
    code = f"import sys, {module}; print([name for name in {HEAVY} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_program_refuses_with_one_line_and_status_2(tmp_path):
    line = line_of_refusal(run_program("fly", "--drones", "0", cwd=tmp_path))
    assert "drones" in line
    assert list(tmp_path.iterdir()) == []


def test_a_reader_that_has_gone_ends_the_program_quietly():
    """As in `moflock --help | head -0`."""
    with subprocess.Popen(
        [MOFLOCK, "--help"],
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment_of({}),
    ) as program:  # fmt: skip
        program.stdout.close()
        complaint = program.stderr.read()
    assert (program.returncode, complaint) == (1, b"")
