"""The tutorial's commands give what the page says."""

from __future__ import annotations

import re
import subprocess

import pytest

from tests.processes import ROOT

PAGE = (ROOT / "docs/tutorial.md").read_text()
# Blocks to type, each with the output that the page shows after it, if it does.
BLOCKS = re.findall(r"```sh\n(.*?)```(?:\n\n```text\n(.*?)```)?", PAGE, re.DOTALL)
# tests/live starts the stack.
PLAYED = [(typed, shown) for typed, shown in BLOCKS if "./deploy/up" not in typed]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The folder of a reader, who goes through the page from its beginning."""
    folder = tmp_path_factory.mktemp("reader")
    (folder / "wbc").symlink_to(ROOT / "wbc")
    return folder


@pytest.mark.parametrize(("typed", "shown"), PLAYED, ids=[typed[:20] for typed, _ in PLAYED])
def test_a_block_gives_what_the_page_says(folder, typed, shown):
    code = int(found[1]) if (found := re.search(r"# .*exit code (\d)", typed)) else 0
    ran = subprocess.run(
        ["sh", "-c", typed], cwd=folder, capture_output=True, text=True, timeout=600, check=False
    )
    assert ran.returncode == code, ran.stderr
    # With one space between words: the page does not show how a terminal aligns them.
    printed = [" ".join(line.split()) for line in ran.stdout.splitlines()]
    assert [line for line in shown.splitlines() if " ".join(line.split()) not in printed] == []


def test_the_page_has_blocks_with_and_without_output():
    assert len(PLAYED) == 4
    assert [bool(shown) for _, shown in PLAYED] == [True, False, False, True]
