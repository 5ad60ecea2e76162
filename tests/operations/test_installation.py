"""The wheel and the source distribution, installed outside of the repository, fly, replay and search."""

import json
import os
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

pytestmark = pytest.mark.slow


def run(*command, cwd):
    """Standard output of a command that must succeed; it sees nothing of this checkout."""
    clean = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(
        [*map(str, command)], cwd=cwd, env=clean, capture_output=True, text=True, timeout=600, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module", params=["wheel", "sdist"])
def moflock(request, tmp_path_factory):
    """The command of a virtual environment that has the built package, and this one's libraries."""
    folder = tmp_path_factory.mktemp(request.param)
    run(sys.executable, "-m", "hatchling", "build", "-t", request.param, "-d", folder / "dist", cwd=ROOT)
    (built,) = (folder / "dist").iterdir()
    venv.create(folder / "venv", with_pip=True)
    scripts = folder / "venv" / "bin"
    (site,) = (folder / "venv" / "lib").glob("python*/site-packages")
    # A plain path: the libraries are found there, and the editable install's own hook is not run.
    (site / "libraries.pth").write_text(sysconfig.get_paths()["purelib"] + "\n")
    run(
        scripts / "python",
        "-m",
        "pip",
        "install",
        "--no-deps",
        "--no-build-isolation",
        "--ignore-installed",
        built,
        cwd=folder,
    )
    return scripts / "moflock", folder


def test_it_is_the_installed_package(moflock):
    command, folder = moflock
    where = run(command.parent / "python", "-c", "import moflock_mj; print(moflock_mj.__file__)", cwd=folder)
    assert where.startswith(str(folder))


def test_it_flies_and_replays(moflock):
    command, folder = moflock
    flown = json.loads(
        run(command, "fly", "--drones", "3", "--duration", "3", "--log", folder / "a.mcap", "--json", cwd=folder)
    )
    assert flown["complete"]
    run(command, "replay", folder / "a.mcap", "--picture", folder / "a.png", cwd=folder)
    assert (folder / "a.png").stat().st_size > 10_000


def test_it_searches(moflock):
    command, folder = moflock
    if folder.name.startswith("sdist"):
        pytest.skip("the wheel's search is enough: both hold the same files")
    arguments = ("--budget", "12", "--population", "4", "--drones", "3", "--duration", "5", "--workers", "1")
    found = json.loads(
        run(command, "optimize", *arguments, "--front-seeds", "2", "--out", folder / "run", "--json", cwd=folder)
    )
    assert found["flights"] == 12
