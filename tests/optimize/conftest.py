"""Run directories that several tests read."""

import pytest

from tests.support.cli import run
from tests.support.search import SMALL


@pytest.fixture(scope="session")
def searched_run(tmp_path_factory):
    """The run directory of a finished search, and what the command printed."""
    path = tmp_path_factory.mktemp("search") / "run"
    done = run("optimize", *SMALL, "--front-seeds", 3, "--out", path)
    assert done.returncode == 0, done.stderr
    return path, done.stdout
