from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import ks_2samp

from netem.generator import calibration
from netem.generator.calibration import (
    Measured,
    distance,
    ns3_runs,
    p_value,
    shared_spikes,
    table,
)
from netem.generator.channel import BUILDING, SCENARIOS
from netem.generator.generate import generate_set
from netem.profile import DelayProfile
from netem.statistics import LINKS
from shared.process.cli import Subcommand, run, run_command

MS = 1_000_000
# One seed, not one per scenario until it fits; `docs/results/network-model.txt` has twelve more.
SEED, COUNT = 2026, 60


@pytest.fixture(scope="module", params=SCENARIOS)
def both(request):
    scenario = SCENARIOS[request.param]
    generated = list(generate_set(scenario, count=COUNT, seed=SEED))
    return scenario, ns3_runs(scenario), generated


@pytest.fixture
def command(monkeypatch, tmp_path):
    """`calibrate` over a few runs only, its files in a folder of the test."""
    monkeypatch.setattr(calibration, "ns3_runs", lambda scenario: ns3_runs(scenario)[:4])
    commands = (Subcommand("calibrate", "", "netem.generator.calibration"),)

    def call(*flags):
        flags = ("--out", str(tmp_path / "f.png"), "--table", str(tmp_path / "t.txt"), *flags)
        monkeypatch.setattr("sys.argv", ["netem", "calibrate", *flags])
        with pytest.raises(SystemExit) as ended:
            run(lambda: run_command(None, commands))
        return ended.value.code

    return call


def profile(up_ms, down_ms):
    return DelayProfile("drawn", np.array([up_ms, down_ms]) * MS)


@pytest.mark.parametrize("link", LINKS)
def test_a_generated_set_is_like_the_ns3_set(both, link):
    _, ns3, generated = both
    found, expected = (Measured(each, link).figures for each in (generated, ns3))
    assert found["base delay (median)"] == pytest.approx(expected["base delay (median)"], rel=0.2)
    for name in ("99 %", "outages per second"):
        assert 1 / 1.5 < found[name] / expected[name] < 1.5, name


def test_the_clear_line_is_as_good_as_in_ns3(both):
    _, ns3, generated = both
    found, expected = (
        np.nanmedian(
            np.concatenate(
                [p.columns["sinr_dl_db"][p.columns["n_block"] == 0].astype(float) for p in each]
            )
        )
        for each in (generated, ns3)
    )
    # Where 60 runs happen to be moves their median by 0.7 dB, in both sets: three times that.
    assert found == pytest.approx(expected, abs=3.0)


def test_no_generated_delay_is_longer_than_the_papers(both):
    scenario, _, generated = both
    for way in ("uplink", "downlink"):
        assert Measured(generated, way).figures["longest"] <= scenario.longest_ms


def test_both_ways_stall_together_as_often_as_in_ns3(both):
    _, ns3, generated = both
    found, expected = shared_spikes(generated), shared_spikes(ns3)
    # The part of 60 runs of few outages each is known to about 0.05.
    assert found == pytest.approx(expected, abs=0.15)


def test_outages_are_measured_as_drawn():
    delays = [2, 2, 30, 29, 28, 2, 2, 2, 15, 2]
    measured = Measured([profile(delays, [2] * 10)], "uplink")
    assert measured.samples["peaks"].tolist() == [30, 15]
    assert measured.samples["durations"].tolist() == [3, 1]
    assert measured.samples["gaps"].tolist() == [3]
    assert measured.samples["longest of a run"].tolist() == [30]
    assert measured.figures["outages per second"] == 200.0


def test_shared_spikes_are_counted_over_sending_times():
    drawn = profile([2, 20, 20, 2, 2, 2, 2, 2], [2, 20, 20, 20, 20, 2, 2, 2])
    assert shared_spikes([drawn]) == (0.5, 1.0)


def test_a_sample_is_at_no_distance_from_itself():
    runs = ns3_runs(BUILDING)[:2]
    text = table(BUILDING, [runs[0], runs[0]], _marked([runs[0]]))
    distances = [line.split() for line in text.splitlines() if line.startswith("every delay")]
    assert len(distances) == len(LINKS)
    assert all("0.000" in cells for cells in distances)


@pytest.mark.parametrize("seed", range(5))
def test_distances_and_their_probabilities_are_those_of_scipy(seed):
    rng = np.random.default_rng(seed)
    one, other = rng.normal(size=200 + seed), rng.normal(0.1 * seed, size=90)
    expected = ks_2samp(one, other, method="asymp")
    d = distance(one, other)
    assert d == pytest.approx(expected.statistic)
    # Both are approximations for large samples, to different orders.
    assert p_value(d, len(one), len(other)) == pytest.approx(expected.pvalue, rel=0.1, abs=0.01)


def _marked(profiles):
    """As if they had been generated at the first draw."""
    return [
        DelayProfile(each.name, each.delays_ns, metadata={**each.metadata, "draws": 1})
        for each in profiles
    ]


def test_the_command_writes_its_table_and_its_figure(command, capsys, tmp_path):
    assert command("--count", "2", "--sets", "2") == 0
    printed = capsys.readouterr().out
    assert (tmp_path / "t.txt").read_text(encoding="utf-8") == printed
    head, *_ = printed.split("\n\n")
    assert "./wbc netem calibrate --seed 0 --count 2 --sets 2" in head
    assert "numpy" in head
    for scenario in SCENARIOS:
        assert f"{scenario}: 4 ns-3 runs, 2 generated" in printed
    assert (tmp_path / "f.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (["--count", "0"], "count: expected from 1 to 10000 profiles, got 0"),
        (["--sets", "0"], "sets: expected from 1 to 100, got 0"),
        (["--seed", "-2"], "seed: expected 0 or more, got -2"),
        (["--count", "1", "--table", "/proc/none/t.txt"], "table: cannot write /proc/none/t.txt"),
        (["--count", "1", "--out", "/proc/none/f.png"], "out: cannot write /proc/none/f.png"),
    ],
)
def test_a_bad_flag_is_one_line(flags, message, command, capsys):
    assert command(*flags) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert message in error
