"""The program `moflock`: its commands, from this package and from entry points, and its exit statuses."""

from __future__ import annotations

import importlib.metadata
import signal
import sys
from types import FrameType

import typer

from moflock_mj.cli import deploy, fleet, fly, preflight, replay, schema
from moflock_mj.cli.options import BAD_INPUT, INTERRUPTED
from moflock_mj.errors import MoflockError, StoppedError
from moflock_mj.rendering.gl import do_without_gl

ENTRY_POINTS = "moflock.commands"
"""Group of the entry points that add commands; each loads a `typer.Typer`."""

_ORDER = ("pca", "optimize", "front", "target", "validate", "identify", "sensitivity")
"""Order of the entry points in `moflock --help`; others follow by name."""


def make_app() -> typer.Typer:
    """Build the command line from all installed commands."""
    app = typer.Typer(
        name="moflock",
        help="Simulate flocks of quadrotors on MuJoCo physics, tune their parameters, and deploy them.",
        add_completion=False,
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )

    @app.callback()
    def moflock() -> None:
        """Simulate flocks of quadrotors on MuJoCo physics, tune their parameters, and deploy them."""

    for part in (fly.commands, replay.commands, *_installed_commands()):
        app.add_typer(part)
    for part in (fleet.commands, preflight.commands, deploy.commands, schema.commands):
        app.add_typer(part)
    return app


def _installed_commands() -> list[typer.Typer]:
    entries = {entry.name: entry for entry in importlib.metadata.entry_points(group=ENTRY_POINTS)}
    names = sorted(entries, key=lambda name: (_ORDER.index(name) if name in _ORDER else len(_ORDER), name))
    return [entries[name].load() for name in names]


def main() -> None:
    """Run the command line; print an error that the user can correct as one line on stderr."""
    signal.signal(signal.SIGTERM, _leave)
    do_without_gl()
    try:
        status = make_app()(sys.argv[1:] or ["--help"], standalone_mode=False)
    except StoppedError as stopped:
        print(stopped, file=sys.stderr)
        status = INTERRUPTED
    except MoflockError as problem:
        status = _refuse(str(problem))
    except typer.TyperException as problem:
        status = _refuse(problem.format_message())
    except (typer.Abort, KeyboardInterrupt):
        status = INTERRUPTED
    except BrokenPipeError:
        sys.stderr.close()
        status = 1
    sys.exit(status if isinstance(status, int) else 0)


def _leave(signal_number: int, frame: FrameType | None) -> None:  # noqa: ARG001
    """Exit through an exception so that clean-up runs; ignore further signals meanwhile."""
    signal.signal(signal_number, signal.SIG_IGN)
    sys.exit(128 + signal_number)


def _refuse(message: str) -> int:
    print("moflock:", " ".join(message.split()), file=sys.stderr)
    return BAD_INPUT
