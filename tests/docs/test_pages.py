"""The pages as they are read in the repository: links, files that they name, blocks in lists."""

from __future__ import annotations

import itertools
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("netem/**/*.md")])
FOLDERS = (
    "shared|robot_node|edge_node|netem|viewer|experiments|benchmarks|deploy|docs|tests|examples"
)


@pytest.fixture(params=PAGES, ids=lambda path: path.relative_to(ROOT).as_posix())
def page(request):
    return request.param


def without_fences(text):
    return re.sub(r"^( *)(`{3,}).*?^\1\2$", "", text, flags=re.DOTALL | re.MULTILINE)


def anchors(path):
    """Of the headings of a page: in lower case, without punctuation, a hyphen for every space."""
    headings = re.findall(r"^#+ (.*)$", without_fences(path.read_text()), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_every_link_leads_somewhere(page):
    dead = []
    for link in re.findall(r"\]\(([^)\s]+)\)", without_fences(page.read_text())):
        if re.match(r"https?://", link):
            continue
        name, _, anchor = link.partition("#")
        target = (page.parent / name).resolve() if name else page
        if not target.exists() or (anchor and anchor not in anchors(target)):
            dead.append(link)
    assert dead == []


def test_every_file_that_a_page_names_is_there(page):
    named = re.findall(rf"`((?:{FOLDERS})/[\w./-]+\.\w+)`", page.read_text())
    gone = [name for name in named if not (ROOT / name).exists()]
    assert gone == []


def test_blocks_in_lists_are_indented_by_four_spaces(page):
    # With two or three they belong to the list in one reader of Markdown, and not in another.
    lines = ["", *page.read_text().splitlines()]
    wrong = [
        line
        for before, line in itertools.pairwise(lines)
        if not before.strip() and re.match(r" {1,3}\S", line)
    ]
    assert wrong == []
