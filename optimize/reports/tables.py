"""Tables of text for a terminal and for Markdown pages."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from rich.table import Table


class Words(NamedTuple):
    """Table of text.

    Attributes:
        title: title of the table.
        head: names of the columns.
        rows: rows with as many cells as `head`.
    """

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Format a table as Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def rich_table(words: Words) -> Table:
    """Build a table for the terminal."""
    table = Table(*words.head, title=words.title, title_justify="left")
    for row in words.rows:
        table.add_row(*row)
    return table
