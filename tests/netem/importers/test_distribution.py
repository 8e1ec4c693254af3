from __future__ import annotations

import numpy as np
import pytest

from netem.profile import DOWNLINK, UPLINK

MS = 1_000_000
# The quantiles of a triangle on ±2 standard deviations' worth of 8192, as a table of 512 numbers.
QUANTILES = (np.arange(512) + 0.5) / 512
TRIANGLE = np.rint(
    8192 * np.where(QUANTILES < 0.5, np.sqrt(2 * QUANTILES) - 1, 1 - np.sqrt(2 - 2 * QUANTILES))
).astype(int)
TABLE = "# a triangle\n" + "\n".join(
    " ".join(str(x) for x in row) for row in TRIANGLE.reshape(-1, 8)
)
DRAW = ("--delay", "10ms", "--jitter", "2ms", "--duration", "20s")


@pytest.fixture
def table(written):
    return written("triangle.dist", TABLE)


def test_delays_have_the_distribution_of_the_table(convert, table):
    profile = convert(table, *DRAW)
    possible = np.rint(10 * MS + 2 * MS * TRIANGLE / 8192)
    for direction in (UPLINK, DOWNLINK):
        delays = profile.delays_ns[direction]
        assert len(delays) == 20_000
        assert set(delays.tolist()) <= set(possible.tolist())
        # The mean of 20 000 draws is good to σ/√20000, 6 µs here; five times that.
        assert abs(delays.mean() - possible.mean()) < 0.03 * MS
        assert abs(np.quantile(delays, 0.9) - np.quantile(possible, 0.9)) < 0.05 * MS
    assert profile.metadata["format"] == "netem"


def test_the_two_ways_are_drawn_each_by_itself_and_from_the_seed(convert, table):
    first, again, other = (convert(table, *DRAW, "--seed", seed) for seed in (1, 1, 2))
    assert first.delays_ns.tolist() == again.delays_ns.tolist()
    assert first.delays_ns.tolist() != other.delays_ns.tolist()
    # Of 20 000 draws without correlation: within 5/√20000.
    assert abs(np.corrcoef(first.delays_ns)[0, 1]) < 0.036


@pytest.mark.parametrize("correlation", ["50%", "0.9"])
def test_correlation_lasts_and_keeps_the_distribution(convert, table, correlation):
    delays = convert(table, *DRAW, "--correlation", correlation).delays_ns[UPLINK]
    rho = 0.5 if correlation == "50%" else 0.9
    found = np.corrcoef(delays[:-1], delays[1:])[0, 1]
    # The triangle is nearly linear in the normal variable: a few hundredths less.
    assert rho - 0.05 < found < rho + 0.02
    possible = 10 * MS + 2 * MS * TRIANGLE / 8192
    # (1 + ρ) / (1 − ρ) times fewer independent draws: 19 at 0.9.
    assert abs(delays.mean() - possible.mean()) < 0.14 * MS
    assert abs(delays.std() / possible.std() - 1) < 0.06


def test_no_delay_is_negative_and_how_many_would_have_been_is_said(convert, table):
    profile = convert(table, "--delay", "1ms", "--jitter", "2ms", "--duration", "1s")
    assert profile.delays_ns.min() == 0
    assert any("negative delays of 1000 taken as 0" in n for n in profile.metadata["notes"])


def test_the_ways_may_have_their_own_mean(convert, table):
    profile = convert(table, "--delay", "10ms/20ms", "--jitter", "0.001ms", "--duration", "100ms")
    assert np.allclose(profile.delays_ns.mean(axis=1), [10 * MS, 20 * MS], atol=2000)


def test_a_table_without_mean_and_deviation_is_refused(refused, table):
    assert "--delay 10ms --jitter 2ms" in refused(table)


@pytest.mark.parametrize("cell", ["x", "40000", "1.5", "nan"])
def test_a_wrong_number_of_a_table_is_named_with_its_line(refused, written, cell):
    file = written("a.dist", f"# a table\n-8192 0\n{cell} 8192\n")
    text = refused(file, "--format", "netem", *DRAW)
    assert "line 3: expected whole numbers from -32768 to 32767" in text
    assert cell in text


HISTOGRAM = """<?xml version="1.0"?>
<histogram>
    <bin low="-inf ms">0</bin>
    <bin low="3ms">10</bin>
    <bin low="4000us">0</bin>
    <bin low="0.005 s">30</bin>
    <bin low="7ms">0</bin>
    <bin low="inf ms">0</bin>
</histogram>
"""


@pytest.mark.parametrize("kind", ["XML", "two columns"])
def test_delays_have_the_shares_of_the_bins(convert, written, kind):
    text = HISTOGRAM if kind == "XML" else "3.0\t10.0\n4.0\t0\n5.0\t30\n7.0\t0\n"
    format_ = () if kind == "XML" else ("--format", "histogram")
    file = written("h.xml", text)
    profile = convert(file, "--other-way", "same", "--duration", "10s", *format_)
    delays = profile.delays_ns[UPLINK] / MS
    low, high = (delays >= 3) & (delays < 4), (delays >= 5) & (delays <= 7)
    assert (low | high).all()
    # A quarter of 10 000: within 5 standard deviations of the count, 216.
    assert abs(low.sum() - 2500) < 220
    assert abs(np.median(delays[high]) - 6) < 0.1


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ('<bin low="8ms">many</bin>', "a bin's count"),
        ('<bin low="8ms">nan</bin>', "a bin's count"),
        ('<bin low="8ms">-1</bin>', "a bin as in"),
        ('<bin low="8h">1</bin>', "a bin as in"),
        ('<bin low="2ms">1</bin>', "in order of their low"),
        ('<bin low="inf ms">1</bin>', "without bounds"),
        ('<bin low="8ms">1', "a bin's count"),
    ],
)
def test_a_wrong_bin_is_named_with_its_line(refused, written, line, words):
    text = HISTOGRAM.replace('    <bin low="inf ms">0</bin>', line)
    message = refused(written("h.xml", text), "--other-way", "same")
    assert "line 8" in message
    assert words in message
