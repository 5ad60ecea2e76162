"""Tables of words and numbers, for a terminal and for a page."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from rich.table import Table


class Words(NamedTuple):
    """A table.

    Attributes:
        title: of it.
        head: names of the columns.
        rows: as many cells each.
    """

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table in Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def rich_table(words: Words) -> Table:
    """A table for the terminal."""
    table = Table(*words.head, title=words.title, title_justify="left")
    for row in words.rows:
        table.add_row(*row)
    return table
