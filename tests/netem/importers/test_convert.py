from __future__ import annotations

import numpy as np
import pytest

from netem.importers.both_ways import files_by_way
from netem.importers.formats import FORMATS
from netem.networks import SHIPPED, load_profile
from netem.profile import DOWNLINK, UPLINK
from netem.profile_file import read_profile
from shared.errors import ProfileError
from shared.process.entry import python
from tests.netem.importers.conftest import run
from tests.processes import played


@pytest.mark.parametrize(
    ("name", "uplink"),
    [
        ("UlPdcpStats.txt", True),
        ("DlRlcStats_perpacket.txt", False),
        ("NrUlPdcpRxStats.txt", True),
        ("NrDlPdcpRxStats.txt.gz", False),
        ("run1_UL.txt", True),
        ("uplink.csv", True),
        ("downlink-3.csv", False),
        ("5G-midband-Downlink.csv", False),
        ("s10-DL_wall.xml", False),
        ("LTE-driving.up", True),
        ("LTE-driving.down", False),
        ("updates.txt", None),
        ("dull.txt", None),
        ("supply.txt", None),
        ("trace.txt", None),
    ],
)
def test_a_name_tells_the_way(tmp_path, name, uplink):
    way = {True: UPLINK, False: DOWNLINK, None: None}[uplink]
    assert list(files_by_way([tmp_path / name], None, None)) == [way]


def test_the_first_of_two_files_is_the_uplink(tmp_path):
    first, second = tmp_path / "a", tmp_path / "b"
    assert files_by_way([first, second], None, None) == {UPLINK: first, DOWNLINK: second}
    assert files_by_way([], second, first) == {UPLINK: second, DOWNLINK: first}


def test_a_profile_goes_from_npz_to_csv_and_back(tmp_path):
    shipped = SHIPPED / "factory" / "001.npz"
    there = run(tmp_path / "a.csv", shipped)
    back = run(tmp_path / "b.npz", tmp_path / "a.csv")
    original = load_profile("factory/001")
    for profile in (there, back):
        assert profile.delays_ns.tolist() == original.delays_ns.tolist()
        assert profile.period_ns == original.period_ns
        assert set(profile.columns) == set(original.columns)
        assert profile.metadata["seed"] == original.metadata["seed"]
        for name, column in original.columns.items():
            assert np.allclose(profile.columns[name], column, equal_nan=True)


def test_what_was_assumed_is_in_the_profile_and_on_the_screen(tmp_path, sample, capsys):
    profile = run(tmp_path / "p.npz", sample("ping_D_sample.txt"))
    shown = capsys.readouterr().out
    assert profile.metadata["source"] == "ping_D_sample.txt"
    assert profile.metadata["format"] == "ping"
    assert profile.metadata["span_s"] == pytest.approx(profile.duration_ns * 1e-9)
    assert profile.metadata["period_us"] == 1000
    assert len(profile.metadata["notes"]) >= 2
    for note in profile.metadata["notes"]:
        assert note in shown


def test_what_was_lost_is_told_in_packets_and_in_time(tmp_path, written, capsys):
    rows = [f"{k / 10},{'' if k % 10 in (5, 6) else 20}\n" for k in range(600)]
    file = written("t.csv", "t_s,rtt_ms\n" + "".join(rows))
    profile = run(tmp_path / "p.npz", file, "--columns", "sent=t_s,rtt=rtt_ms")
    words = "120 of 600 packets lost (20.00 %), 20.03 % of the time lost, 0.2 s of it at a stretch"
    assert capsys.readouterr().out.count(words) == 2
    assert profile.metadata["interpolated"]["uplink"] == pytest.approx(0.79, abs=0.01)


def test_a_period_is_chosen(convert, sample):
    profile = convert(sample("ping_D_sample.txt"), "--period", "500us")
    assert profile.period_ns == 500_000
    assert 690 <= profile.delays_ns.shape[1] <= 700


def test_an_unknown_format_is_refused_with_all_names(refused, sample, written):
    text = refused(sample("ping_D_sample.txt"), "--format", "sundial")
    assert "'sundial'" in text
    for each in FORMATS:
        assert each.name in text
    text = refused(written("what.txt", "dear diary\n"))
    for each in FORMATS:
        assert each.name in text


def test_one_way_alone_is_refused_with_how_to_say_the_other(refused, sample, written):
    text = refused(sample("UlPdcpStats_perpacket.txt"))
    for words in ("--uplink", "--downlink", "--other-way same", "--other-way constant:5ms"):
        assert words in text
    nameless = written("pdcp.txt", sample("UlPdcpStats_perpacket.txt").read_bytes())
    assert "expected a known direction" in refused(nameless, "--other-way", "constant:5ms")


@pytest.mark.parametrize("file", ["nothing.txt", ".", "nothing.npz"])
def test_a_file_that_cannot_be_read_is_refused(refused, tmp_path, file):
    for more in ((), ("--format", "table"), ("--format", "irtt"), ("--format", "ns3")):
        assert "cannot read it" in refused(tmp_path / file, *more)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--load", "40000@1kHz"), "--load: expected a size as in 40000B"),
        (("--load", "40000B"), "--load: expected a load as in 40000B@1kHz"),
        (("--load", "1B@1Hz/1B@1Hz/1B@1Hz"), "one value or UPLINK/DOWNLINK"),
        (("--base-delay", "2"), "--base-delay: expected a duration"),
        (("--period", "2s"), "--period: expected a period from 1us to 1s"),
        (("--clock", "sundial"), "--clock: expected offset or half"),
        (("--rnti", "x"), "--rnti: expected N"),
        (("--correlation", "150%"), "--correlation: expected a fraction"),
        (("--queue", "3"), "--queue: expected a size"),
        (("--seed", "-1"), "--seed"),
        (("--pause", "skip"), "--pause: expected one of refuse, cut, lost"),
        (("--lone-loss", "1ms"), "--lone-loss: expected interval or period"),
        (("--interval", "10ms"), "--interval: expected a file of ping, table, got"),
        (("--jitter", "10ms"), "--jitter: expected a file of netem, got"),
        (("--other-way", "up"), "--other-way: expected same or constant:5ms"),
        (("--other-way", "constant:5"), "--other-way: expected a duration"),
    ],
)
def test_a_wrong_flag_is_refused_with_what_it_takes(refused, sample, arguments, words):
    assert words in refused(sample("UlPdcpStats_perpacket.txt"), *arguments)


def test_a_profile_of_another_name_or_that_cannot_be_written_is_refused(tmp_path, sample):
    for out in ("out.txt", "out"):
        with pytest.raises(ProfileError, match="expected the profile to write last"):
            run(tmp_path / out, sample("ping_D_sample.txt"))
    (tmp_path / "folder.npz").mkdir()
    with pytest.raises(ProfileError, match="cannot write it"):
        run(tmp_path / "folder.npz", sample("ping_D_sample.txt"))


def test_the_command_itself_converts_and_says_errors_in_one_line(tmp_path, sample):
    out = tmp_path / "out.npz"
    command = python("-m", "netem", "convert")
    files = [str(sample("ping_D_sample.txt")), str(out)]
    done = played(*command, *files)
    assert (done.returncode, done.stderr) == (0, "")
    assert read_profile(out).metadata["format"] == "ping"
    done = played(*command, str(out))
    assert done.returncode == 2
    assert done.stderr.startswith("error: ")
    assert done.stderr.count("\n") == 1
