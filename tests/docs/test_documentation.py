"""Every example of the README and of the site runs, or a comment above it says why not."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]

# A block in a list is indented, and so is the comment above it.
_BLOCK = re.compile(
    r"^ *(?:<!-- not run: (?P<reason>[^\n]+?) -->\n *)?```(?P<language>[a-z]+)\n(?P<text>.*?)^ *```$",
    re.MULTILINE | re.DOTALL,
)

_LONGEST = 600
"""s, of one block; a first flight compiles its loop."""


class Block(NamedTuple):
    """A fenced block of a page.

    Attributes:
        place: page and line.
        language: of the fence.
        text: what is in it.
        reason: why it is not run; None if it is.
    """

    place: str
    language: str
    text: str
    reason: str | None


def blocks_of(page):
    text = page.read_text("utf-8")
    return [
        Block(
            f"{page.relative_to(ROOT)}:{text.count(chr(10), 0, match.start('text'))}",
            match["language"],
            textwrap.dedent(match["text"]),
            match["reason"],
        )
        for match in _BLOCK.finditer(text)
    ]


def script_of(block):
    """The shell commands of a block; in a console session those after the prompt."""
    if block.language != "console":
        return block.text
    return "".join(f"{line[2:]}\n" for line in block.text.splitlines() if line.startswith("$ "))


def is_example(block):
    return block.language == "python" or (block.language in ("bash", "console") and "moflock" in block.text)


PAGES_WITH_EXAMPLES = [page for page in PAGES if any(map(is_example, blocks_of(page)))]


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES_WITH_EXAMPLES, ids=lambda page: page.name)
def test_examples_run(page, tmp_path):
    """The blocks of a page run in their order in one folder, as a reader would run them."""
    (tmp_path / "docs").mkdir()
    for scenario in (ROOT / "docs").glob("*.toml"):
        shutil.copy(scenario, tmp_path / "docs")
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    for block in filter(is_example, blocks_of(page)):
        if block.reason is not None:
            continue
        command = [sys.executable, "-c", block.text]
        if block.language != "python":
            command = ["bash", "-euo", "pipefail", "-c", script_of(block)]
        done = subprocess.run(
            command, cwd=tmp_path, env={**os.environ, "PATH": path}, capture_output=True, text=True, timeout=_LONGEST,
            check=False,
        )  # fmt: skip
        assert done.returncode == 0, f"{block.place}\n{done.stdout}\n{done.stderr}"


def test_the_pages_have_examples():
    run = [block for page in PAGES for block in blocks_of(page) if is_example(block) and block.reason is None]
    assert {block.language for block in run} >= {"python", "bash"}
    assert any(block.place.startswith("README.md") for block in run)


def test_each_reason_stands_above_an_example():
    """A comment that is not directly above a block would be ignored, and hide nothing."""
    for page in PAGES:
        found = sum(block.reason is not None for block in blocks_of(page))
        assert page.read_text("utf-8").count("<!-- not run:") == found, page.name


def test_the_readme_is_short_and_its_files_exist():
    text = (ROOT / "README.md").read_text("utf-8")
    assert len(text.splitlines()) <= 150
    for target in re.findall(r"\]\(([^)#]+)\)", text):
        assert target.startswith("https://") or (ROOT / target).exists(), target


def test_every_page_is_in_the_navigation():
    navigation = (ROOT / "mkdocs.yml").read_text("utf-8").partition("\nnav:\n")[2]
    assert sorted(re.findall(r": (\w+\.md)$", navigation, re.MULTILINE)) == [page.name for page in PAGES[1:]]
