"""From `run` to the page that `report` writes, with trials of a few ticks."""

from __future__ import annotations

import argparse
import re

import pytest
import tomli_w

from experiments.reproduction import figures, run
from experiments.reproduction.compute_times import (
    LOCAL,
    QP,
    QUICK_SECONDS,
    ComputeTimes,
    MessageSize,
    Time,
)
from experiments.reproduction.report import add_report_arguments, run_report
from experiments.reproduction.run import NAMES, add_reproduction_arguments, chosen, run_reproduction
from experiments.reproduction.sections import SECTIONS, STUDIES
from experiments.studies.study_file import read_study
from experiments.studies.trial_table import read_trials
from shared.errors import ConfigError
from tests.experiments.reproduction.made_up import finished

TIMES = ComputeTimes(
    network="building/001",
    seconds=3.0,
    repetitions=3,
    scale=3.0,
    pinned=True,
    cpu="a processor",
    versions={},
    times=(
        Time(QP, calls=9, mean_ms=0.36, p99_ms=0.5, worst_ms=0.8, undisturbed_worst_ms=0.6),
        Time(LOCAL["la"], calls=9, mean_ms=0.1, p99_ms=0.2, worst_ms=0.3, undisturbed_worst_ms=0.2),
    ),
    messages=(MessageSize("la", "downlink", 14_000.0, 28_000, 1000.0),),
)


def command(add_arguments, run_command):
    """A command as from the command line."""
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    return lambda *arguments: run_command(parser.parse_args([str(each) for each in arguments]))


run_names = command(add_reproduction_arguments, run_reproduction)
report = command(add_report_arguments, run_report)


@pytest.fixture
def shortened(monkeypatch, tmp_path):
    """Studies as shipped, but of 50 ticks each."""

    def read(name, *, quick=False):
        table = read_study(name, quick=quick, seeds=1).table
        table["base"] = table.get("base", {}) | {"duration": 0.05}
        path = tmp_path / "studies" / f"{name}.toml"
        path.parent.mkdir(exist_ok=True)
        path.write_text(tomli_w.dumps(table))
        return read_study(path)

    for module in (run, figures):
        monkeypatch.setattr(module, "read_study", read)


def test_what_is_run_becomes_a_page_with_its_trials_and_figures(shortened, tmp_path, capsys):
    out, docs = tmp_path / "out", tmp_path / "docs"
    assert run_names("table6", "fig6", "--quick", "--workers", "1", "--out", out) == 0
    message = capsys.readouterr()
    assert "Table VI, walk\ncardinality  LA ticks" in message.out
    assert "study table6, 1 to go" in message.err
    assert report("--out", out, "--docs", docs) == 0

    page = (docs / "results.md").read_text()
    assert "Played with `--quick`, on few seeds: table6." in page
    assert re.search(r"Missing: .*table2, .*tolerance-walk, table5, fig4, fig5\.", page)
    assert "## Table VI" in page
    assert "## Table II:" not in page
    assert "| not played | Table II" in page
    links = re.findall(r"\]\(([^)]+)\)", page)
    assert "figures/fig6.svg" in links
    elsewhere = ["reproduction.md", "#how-numbers-are-judged"]
    assert [link for link in links if not (docs / link).is_file()] == elsewhere
    assert page.index("## Figure 6") < page.index("## Table VI") < page.index("### Table VI, walk")
    kept = docs / "results" / "trials" / "table6"
    assert read_trials(kept) == read_trials(out / "table6")
    assert len(read_study(kept).trials) == 4
    # A study of which nothing is left to play is not played again.
    before = (out / "table6" / "trials.jsonl").read_bytes()
    assert run_names("table6", "--quick", "--out", out) == 0
    assert (out / "table6" / "trials.jsonl").read_bytes() == before


def test_the_same_figure_is_drawn_twice(shortened, tmp_path):
    for folder in ("first", "second"):
        for draw in figures.FIGURES.values():
            draw(tmp_path / folder)
    drawn = sorted((tmp_path / "first").iterdir())
    assert [path.name for path in drawn] == [
        f"fig{number}.{suffix}" for number in (4, 5, 6) for suffix in ("png", "svg")
    ]
    for path in drawn:
        assert path.read_bytes() == (tmp_path / "second" / path.name).read_bytes()


def test_the_whole_report_has_every_table_and_misses_nothing_but_figures(tmp_path, capsys):
    finished(tmp_path / "out", *STUDIES, seeds=1)
    assert report("--out", tmp_path / "out", "--docs", tmp_path / "docs") == 0
    page = (tmp_path / "docs" / "results.md").read_text()
    assert "Missing: table5, fig4, fig5, fig6." in page
    # The made-up PR falls beyond 40 ms and in every walk beyond 3 ms, LA beyond 100 ms.
    glance = page[page.index("## At a glance") : page.index("## The paper's conclusions")]
    assert re.search(r"Table II, balance: [^|]*\| 40 \| 40 \| 100 \| 90 \| ≥ 400 \|", glance)
    assert re.search(
        r"Table IV, factory, walk: [^|]*\|[^|]*\| 0 % \|[^|]*\| 85 % \| 100 % \|", glance
    )
    for name in STUDIES:
        assert f"[{name}](results/trials/{name}/study.toml)" in page
    assert "holds: Table IV, factory, walk: LA's success" in capsys.readouterr().out


def test_computation_times_are_kept_for_the_code_that_took_them(monkeypatch, tmp_path, capsys):
    measured = []

    def measure(*, seconds=None):
        measured.append(seconds)
        return TIMES

    monkeypatch.setattr(run, "measure", measure)
    for quick in ([], [], ["--quick"]):
        assert run_names("table5", *quick, "--out", tmp_path) == 0
    assert measured == [None, QUICK_SECONDS]
    assert re.search(r"1\.2 GHz +full QP +1\.08 +1\.21 +same or better", capsys.readouterr().out)
    assert report("--out", tmp_path, "--docs", tmp_path / "docs") == 0
    page = (tmp_path / "docs" / "results.md").read_text()
    judged = "0.36 | 0.36 | same or better | 0.60 | 0.70 | same or better"
    assert f"| 3.7 GHz | full QP | {judged} | 0.80 |" in page
    assert "Played with `--quick`, on few seeds: table5." in page
    assert "| holds | Table V: the local controller takes less time than the QP |" in page


def test_all_is_every_table_and_figure_and_the_order_is_ours():
    assert chosen(["all"]) == list(NAMES)
    assert set(NAMES) >= {"fig4", "fig5", "fig6", *SECTIONS}
    assert chosen(["table4", "fig4", "table4"]) == ["fig4", "table4"]


def test_every_study_has_a_quick_form_that_is_smaller():
    for name in STUDIES:
        # Of the full studies a few seeds are enough here: profiles take a while to generate.
        full, quick = read_study(name, seeds=3), read_study(name, quick=True)
        assert len(quick.trials) < len(full.trials)
        assert {cell.shown.get("controller") for cell in quick.cells} == {
            cell.shown.get("controller") for cell in full.cells
        }


def test_an_unknown_table_is_one_clear_error(tmp_path):
    with pytest.raises(ConfigError, match=r"fig4, fig5, .*table6, all, got 'tabel2'; did you"):
        run_names("table2", "tabel2", "--out", tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("options", "output"),
    [
        (["--workers", "0"], "expected at least 1, got 0"),
        (["--workers", "2", "--scheduler", "tcp://a:1"], "expected without --scheduler"),
    ],
)
def test_workers_that_cannot_be_are_refused_before_anything_is_played(options, output, tmp_path):
    with pytest.raises(ConfigError, match=output):
        run_names("fig4", *options, "--out", tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_report_of_nothing_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="which does not exist"):
        report("--out", tmp_path / "nowhere", "--docs", tmp_path / "docs")


def test_a_page_that_cannot_be_written_is_one_clear_error(tmp_path):
    (tmp_path / "docs").write_text("a file")
    with pytest.raises(ConfigError, match="cannot write"):
        report("--out", tmp_path, "--docs", tmp_path / "docs")


def test_a_study_that_two_tables_share_is_played_once(monkeypatch, tmp_path):
    played = []
    monkeypatch.setattr(run, "sweep", lambda study, **options: played.append(study.name))
    assert run_names("table2", "table3", "table4", "--quick", "--out", tmp_path) == 0
    assert sorted(played) == [name for name in STUDIES if name != "table6"]


def test_an_interruption_says_that_the_same_command_goes_on(monkeypatch, tmp_path, capsys):
    def interrupted(*arguments, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr(run, "sweep", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run_names("table6", "--quick", "--out", tmp_path)
    assert "the same command continues" in capsys.readouterr().err
