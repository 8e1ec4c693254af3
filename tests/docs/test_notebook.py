"""The notebook runs, and prints and draws what it did when it was written."""

from __future__ import annotations

import nbformat
import pytest
from nbclient import NotebookClient

from docs.hooks import notebook_page
from tests.processes import ROOT

NOTEBOOK = ROOT / "examples/two_runs.ipynb"


@pytest.fixture(scope="module")
def played(tmp_path_factory):
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    folder = tmp_path_factory.mktemp("notebook")
    NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(folder)}}).execute()
    return notebook


def outputs(notebook):
    """Of each cell: its printed words, and the kinds of its pictures."""
    return [
        [output.get("text") or sorted(output.data) for output in cell.get("outputs", [])]
        for cell in notebook.cells
    ]


def test_the_notebook_prints_and_draws_what_its_file_shows(played):
    written = outputs(nbformat.read(NOTEBOOK, as_version=4))
    path = NOTEBOOK.relative_to(ROOT)
    assert outputs(played) == written, f".venv/bin/jupyter execute --inplace {path} writes it anew"


def test_the_notebook_draws_delay_age_error_and_active_set(played):
    pictures = [
        cell.source
        for cell in played.cells
        for output in cell.get("outputs", [])
        if "image/png" in output.get("data", {})
    ]
    shown = ("achieved_ns", "projector_age_ns", "com_error_m", "active_set")
    assert [name for name, source in zip(shown, pictures, strict=True) if name in source] == [
        *shown
    ]


def test_the_page_of_the_notebook_has_its_code_its_words_and_its_pictures():
    page = notebook_page(NOTEBOOK)
    assert page.startswith("# Two runs, side by side\n")
    assert "```python\nRUNS = Path(" in page
    assert "```text\nPR: " in page
    assert page.count("](data:image/png;base64,") == 4
