"""The command `moflock schema`: print the JSON schema of scenario files."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

commands = typer.Typer()


@commands.command("schema", epilog="Example: moflock schema --out scenario.schema.json")
def schema_command(
    out: Annotated[Path | None, typer.Option(help="File to write, .json; stdout if absent.")] = None,
) -> int:
    """Print the JSON schema of scenario files, for editors that complete and check TOML."""
    import json

    from moflock_mj.files import new_file
    from moflock_mj.scenario.schema import scenario_schema

    text = json.dumps(scenario_schema(), indent=2) + "\n"
    if out is None:
        print(text, end="")
        return 0
    with new_file(out) as place:
        place.write_text(text, encoding="utf-8")
    print(out)
    return 0
