"""The docs site is built without a warning and without anything from elsewhere."""

from __future__ import annotations

import os
import re
import subprocess
from html import unescape
from urllib.parse import unquote, urlsplit

import pytest
from pymdownx.superfences import SuperFencesException

from docs.hooks import mathml, with_formulas, with_subscripts
from docs.reference_pages import columns_page, commands_page, messages_page
from remote_wbc import commands
from shared.process.cli import Group
from shared.process.entry import python
from shared.telemetry.schema import LINK_SCHEMA, SOLVE_SCHEMA, STEP_SCHEMA, tick_schema
from tests.processes import ROOT

PACKAGES = ("robot_node", "edge_node", "netem", "viewer", "deploy", "experiments")


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


def test_every_link_of_the_site_leads_to_a_file_and_a_place_in_it(site):
    texts = pages(site)
    places = {name: set(re.findall(r'\bid="?([^"\s>]+)', text)) for name, text in texts.items()}
    dead = []
    for name, text in texts.items():
        if name == "404.html":  # the only page with links from the site's root
            continue
        for link in re.findall(r'<(?:a|link|img|script)\b[^>]*?\b(?:href|src)="?([^"\s>]+)', text):
            parts = urlsplit(unescape(link))
            if parts.scheme:
                continue
            target = (site / name).parent / unquote(parts.path) if parts.path else site / name
            of_page = places.get(os.path.relpath(target, site))
            if not target.is_file() or (
                parts.fragment and of_page is not None and unquote(parts.fragment) not in of_page
            ):
                dead.append(f"{name}: {link}")
    assert dead == []


def test_the_search_works_from_files(site):
    # A browser lets no page of a file fetch an index or start a worker.
    assert (site / "search" / "search_index.js").read_text().startswith("var __index = {")
    for page, to_root in (("index.html", ""), ("reference/wbc.html", "../")):
        assert f'<script src="{to_root}site/iframe-worker.js">' in (site / page).read_text()


@pytest.mark.parametrize("page", ["maths", "locally-corrected", "network-model", "profiles"])
def test_every_equation_is_shown(site, page):
    equations = (ROOT / f"docs/{page}.md").read_text().count("```math\n")
    text = (site / f"{page}.html").read_text()
    assert equations > 0
    assert text.count('display="block"') == equations
    assert text.count('display="inline"') > 0


def test_a_formula_in_the_text_is_shown_as_the_equations_are():
    shown = with_formulas(r'so <span class="arithmatex">\(C_{\mathcal{A}}^\top f &lt; 1\)</span>.')
    # The index and the raised T are one above the other.
    assert "<msubsup><mi>C</mi><mrow><mi>𝒜</mi></mrow><mo>⊤</mo></msubsup>" in unescape(shown)
    assert "<mo>&#x0003C;</mo>" in shown
    assert re.fullmatch("so <math[^>]*inline.*</math>[.]", shown)


def test_no_page_shows_the_source_of_a_formula(site):
    for name, text in pages(site).items():
        prose = re.sub(r"(?s)<(pre|code|script|style)\b.*?</\1>", "", text)
        assert re.findall(r"arithmatex|\\[a-z]+", prose) == [], name


def test_an_equation_that_would_be_shown_as_it_is_written_is_refused():
    with pytest.raises(SuperFencesException, match="aligned"):
        mathml(r"\begin{aligned} a &= b \\ c &= d \end{aligned}")
    with pytest.raises(SuperFencesException, match="an equation"):
        mathml(r"\nosuchcommand x")

    # Browsers show the variant of a letter by the letter alone.
    with pytest.raises(SuperFencesException, match="an equation"):
        mathml(r"\mathcal x")
    assert "ℬ" in unescape(mathml(r"\mathcal{B}"))


def test_the_bars_of_a_norm_are_of_one_size():
    bars = re.findall("<mo[^>]*>&#x02016;", mathml(r"\lVert x \rVert^2"))
    assert bars == ['<mo stretchy="false">&#x02016;'] * 2


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("J_c a", "J<sub>c</sub> a"),
        ("J̇_c v, s̈_ref", "J̇<sub>c</sub> v, s̈<sub>ref</sub>"),
        ("√ω_f f, C_𝒜ᵀ λ, f_x,y", "√ω<sub>f</sub> f, C<sub>𝒜</sub>ᵀ λ, f<sub>x,y</sub>"),
        ("(P₀)_ff", "(P₀)<sub>ff</sub>"),
        ("(k, n_z + n_rows)", "(k, n<sub>z</sub> + n<sub>rows</sub>)"),
        ("<code>J_c</code> <pre><span>k_p</span></pre>",) * 2,
        ('<a href="a_b.html">the wall_ns of robot_node, q_des_x</a>',) * 2,
    ],
)
def test_a_subscript_is_lowered_in_text_and_not_in_code(text, shown):
    assert with_subscripts(text) == shown


@pytest.mark.parametrize(
    "package",
    [
        "wbc",
        "motion",
        "robots",
        "config",
        "wire",
        "bus",
        "telemetry",
        "output",
        "process",
        "robot_node",
        "edge_node",
        "netem",
        "viewer",
        "deploy",
        "experiments",
    ],
)
def test_the_reference_has_the_docstrings_of_a_package(site, package):
    folder = ROOT / ("." if (ROOT / package).is_dir() else "shared") / package
    text = (site / f"reference/{package}.html").read_text()
    names = [path.stem for path in folder.glob("*.py") if not path.stem.startswith("__")]
    dotted = folder.relative_to(ROOT).as_posix().replace("/", ".")
    assert [name for name in names if f'id="{dotted}.{name}"' not in text] == []


def test_a_link_to_a_source_file_leads_to_a_page_of_it(site):
    text = (site / "examples.html").read_text()
    assert 'href="source/examples/own_task.py.html"' in text
    assert "KneeBends" in (site / "source/examples/own_task.py.html").read_text()


def test_the_reference_has_every_command_and_its_options():
    page = commands_page()
    for command in commands():
        assert f"\n## {command.name}\n" in page
        for each in command.commands if isinstance(command, Group) else ():
            assert f"\n### {command.name} {each.name}\n" in page
    assert "| `--network-start 12.5s` | start of the run in the profile" in page
    assert "SUPPRESS" not in page


def test_the_reference_has_every_column_with_its_meaning():
    page = columns_page()
    for schema in (tick_schema(nq=38, nv=37), LINK_SCHEMA, SOLVE_SCHEMA, STEP_SCHEMA):
        for column in schema.columns:
            assert column.help, column.name
            assert f"| `{column.name}` | " in page
    assert "| `q` | 38 × float64 | m, rad |" in page


def test_the_reference_has_every_message_with_its_fields():
    page = messages_page()
    for name in ("RobotState", "ProjectorMessage", "FactorisationMessage"):
        assert f"\n## {name}\n" in page
    assert "| `held_sequences` | `tuple[int, ...] | None` |" in page
