"""The docs site is built without a warning and without anything from elsewhere."""

from __future__ import annotations

import os
import re
import subprocess

import pytest
from pymdownx.superfences import SuperFencesException

from docs.hooks import mathml
from shared.process.entry import python
from tests.processes import ROOT


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The folder of the site, built as `./deploy/docs` does; whoever asks a proxy gets nothing."""
    out = tmp_path_factory.mktemp("site")
    nobody = dict.fromkeys(("http_proxy", "https_proxy", "all_proxy"), "http://127.0.0.1:9")
    built = subprocess.run(
        python("-m", "mkdocs", "build", "--strict", "--site-dir", str(out)),
        cwd=ROOT,
        env={**os.environ, **nobody},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert built.returncode == 0, built.stdout + built.stderr
    return out


def pages(site):
    return {path.relative_to(site).as_posix(): path.read_text() for path in site.rglob("*.html")}


def test_a_page_fetches_nothing_from_elsewhere(site):
    for name, text in pages(site).items():
        fetched = re.findall(r'<(?:script|link|img|iframe)[^>]*?(?:src|href)="?([^" >]+)', text)
        assert fetched, name
        assert [each for each in fetched if re.match(r"(https?:)?//", each)] == [], name


@pytest.mark.parametrize("page", ["maths", "locally-corrected", "network-model", "profiles"])
def test_every_equation_is_shown(site, page):
    equations = (ROOT / f"docs/{page}.md").read_text().count("```math\n")
    text = (site / f"{page}.html").read_text()
    assert equations > 0
    assert text.count("<math ") == equations


def test_an_equation_that_would_be_shown_as_it_is_written_is_refused():
    with pytest.raises(SuperFencesException, match="aligned"):
        mathml(r"\begin{aligned} a &= b \\ c &= d \end{aligned}")
    with pytest.raises(SuperFencesException, match="an equation"):
        mathml(r"\nosuchcommand x")


@pytest.mark.parametrize("package", ["wbc", "motion", "robot_node", "edge_node", "netem"])
def test_the_reference_has_the_docstrings_of_a_package(site, package):
    folder = ROOT / ("shared" if package in ("wbc", "motion") else ".") / package
    text = (site / f"reference/{package}.html").read_text()
    names = [path.stem for path in folder.glob("*.py") if not path.stem.startswith("__")]
    dotted = folder.relative_to(ROOT).as_posix().replace("/", ".")
    assert [name for name in names if f'id="{dotted}.{name}"' not in text] == []


def test_a_link_to_a_source_file_leads_to_a_page_of_it(site):
    text = (site / "examples.html").read_text()
    assert 'href="source/examples/own_task.py.html"' in text
    assert "KneeBends" in (site / "source/examples/own_task.py.html").read_text()
