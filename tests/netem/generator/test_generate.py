from __future__ import annotations

import hashlib
from collections import deque

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from netem.capacity import capacity_of
from netem.generator.channel import BUILDING, FACTORY, SCENARIOS
from netem.generator.generate import (
    generate_profile,
    generate_set,
    parse_bytes,
)
from netem.generator.queueing import delays_ns, departures
from netem.profile import DIRECTIONS, DOWNLINK, LOST, UPLINK
from netem.profile_file import read_profile
from shared.errors import ConfigError
from shared.process.cli import Subcommand, run, run_command

MS = 1_000_000
capacities = st.lists(st.integers(0, 50), min_size=1, max_size=30).map(np.array)
sizes = st.integers(1, 40)
queues = st.integers(20, 300)


def brute_force(capacity, size, queue_bytes):
    """A byte at a time, from the head of the queue; when the last of each message leaves."""
    left = [np.nan] * len(capacity)
    waiting: deque[int] = deque()
    for k, carried in enumerate(capacity):
        if len(waiting) + size <= queue_bytes:
            waiting.extend([k] * size)
            left[k] = np.inf
        for byte in range(min(carried, len(waiting))):
            message = waiting.popleft()
            if not waiting or waiting[0] != message:
                left[message] = k + (byte + 1) / carried
    return np.array(left)


@given(capacity=capacities, size=sizes, queue_bytes=queues)
def test_the_queue_is_that_of_a_simulation_byte_by_byte(capacity, size, queue_bytes):
    found = departures(capacity, message_bytes=size, queue_bytes=queue_bytes)
    expected = brute_force(capacity, size, queue_bytes)
    np.testing.assert_allclose(found, expected, atol=1e-9)


@given(capacity=capacities, size=sizes)
def test_what_has_left_is_the_least_of_what_had_come_and_what_was_carried_since(capacity, size):
    found = departures(capacity, message_bytes=size, queue_bytes=np.inf)
    n = len(capacity)
    for t in range(1, n + 1):
        came = [size * s for s in range(t)] + [size * t]
        least = min(came[s] + capacity[s:t].sum() for s in range(t + 1))
        assert np.sum(found <= t + 1e-9) == least // size


@given(capacity=capacities, size=sizes, queue_bytes=queues)
def test_every_message_leaves_waits_or_is_lost_and_none_overtakes(capacity, size, queue_bytes):
    found = departures(capacity, message_bytes=size, queue_bytes=queue_bytes)
    left, waiting, lost = np.isfinite(found), np.isinf(found), np.isnan(found)
    assert left.sum() + waiting.sum() + lost.sum() == len(capacity)
    assert left.sum() * size <= capacity.sum()
    assert waiting.sum() * size <= queue_bytes + size
    assert np.all(np.diff(found[~lost & left]) >= 0.0)
    assert np.all(found[left] >= np.flatnonzero(left))


def test_a_message_that_never_leaves_is_lost():
    found = departures(np.array([100.0, 0.0, 0.0]), message_bytes=50, queue_bytes=60)
    assert delays_ns(found, base_ns=MS, period_ns=MS).tolist() == [1_500_000, LOST, LOST]


@pytest.mark.parametrize("scenario", SCENARIOS.values(), ids=SCENARIOS)
def test_the_delays_are_those_of_the_capacity_in_the_file(scenario):
    profile = generate_profile(scenario, 4)
    capacity = capacity_of(profile)
    for way, size in ((UPLINK, 1_000), (DOWNLINK, 40_000)):
        delay_ns = capacity.source(way, queue_bytes=20 * 2**20)
        # The last second is left out: there the replayed capacity begins again from the start.
        replayed = np.array([delay_ns(k * MS, size) for k in range(5000)])
        difference = replayed - profile.delays_ns[way, :5000]
        # The base delay is read off the profile, to some of the time that a message's own bytes
        # take. Bytes are whole numbers in the file.
        assert np.abs(difference - np.median(difference)).max() < 0.05 * MS
        assert np.abs(np.median(difference)) < 0.2 * MS


def test_the_same_seed_gives_the_same_file_to_the_byte(tmp_path, command):
    for folder in ("a", "b"):
        command("building", "--count", "2", "--seed", "5", "--out", str(tmp_path / folder))
    first, second = (
        [
            hashlib.sha256((tmp_path / folder / f"building-000{k}.npz").read_bytes()).hexdigest()
            for k in range(2)
        ]
        for folder in ("a", "b")
    )
    assert first == second
    assert first[0] != first[1]


def test_a_profile_depends_on_its_own_seed_alone():
    later = list(generate_set(FACTORY, count=2, seed=11))
    whole = list(generate_set(FACTORY, count=4, seed=10))
    for one, other in zip(later, whole[1:3], strict=True):
        assert one.metadata == other.metadata
        np.testing.assert_array_equal(one.delays_ns, other.delays_ns)


def test_two_scenarios_of_one_seed_are_drawn_apart():
    factory, building = (
        [float(blocker["fraction"]) for blocker in generate_profile(each, 1).metadata["blockers"]]
        for each in (FACTORY, BUILDING)
    )
    # Both draw from the same range: of one stream of numbers they would be equal.
    assert set(factory).isdisjoint(building)


def test_a_larger_load_has_the_same_channel_and_never_a_shorter_delay():
    light = generate_profile(BUILDING, 3, uplink_bytes=100, downlink_bytes=1_000)
    usual = generate_profile(BUILDING, 3)
    heavy = generate_profile(BUILDING, 3, uplink_bytes=2_000, downlink_bytes=80_000)
    for one, other in ((light, usual), (usual, heavy)):
        for name, column in one.columns.items():
            np.testing.assert_array_equal(column, other.columns[name])
        assert np.all(other.delays_ns >= one.delays_ns)
    assert np.any(heavy.delays_ns > light.delays_ns)


@pytest.mark.parametrize("scenario", SCENARIOS.values(), ids=SCENARIOS)
def test_no_message_of_the_papers_load_takes_longer_than_in_the_paper(scenario):
    for profile in generate_set(scenario, count=20, seed=100):
        assert LOST not in profile.delays_ns
        # 1 ms to the edge, whatever else
        assert profile.delays_ns.min() > 1 * MS
        assert profile.delays_ns.max() <= scenario.longest_ms * MS


def test_a_file_says_what_it_is_and_holds_the_channel(tmp_path, command, capsys):
    command(
        *("factory", "--count", "2", "--seed", "7", "--seconds", "1.5", "--out", str(tmp_path)),
        *("--uplink", "500B", "--downlink", "20kB"),
    )
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "factory-0000.npz",
        "factory-0001.npz",
    ]
    profile = read_profile(tmp_path / "factory-0001.npz")
    assert profile.delays_ns.shape == (2, 1500)
    expected = {
        "scenario": "factory",
        "source": "generated, docs/network-model.md",
        "seed": 8,
        "uplink_bytes": 500,
        "downlink_bytes": 20_000,
        "rate_hz": 1000.0,
        "period_us": 1000.0,
    }
    assert expected.items() <= profile.metadata.items()
    assert 20.0 <= profile.metadata["distance"] <= 101.0
    assert len(profile.metadata["blockers"]) == 4
    for name in ("n_block", "sinr_dl_db", *(f"{way}_capacity_bytes" for way in DIRECTIONS)):
        assert profile.columns[name].shape == (1500,)
    assert "2 profiles of 1.5 s" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (["street"], "scenario: expected one of factory, building, got 'street'"),
        (["factory", "--count", "-3"], "count: expected from 1 to 10000 profiles, got -3"),
        (["factory", "--count", "many"], "invalid int value: 'many'"),
        (["factory", "--seed", "-1"], "seed: expected 0 or more, got -1"),
        (["factory", "--seconds", "0"], "seconds: expected from 0.1 to 60, got 0"),
        (["factory", "--seconds", "nan"], "seconds: expected from 0.1 to 60, got nan"),
        (["factory", "--uplink", "0B"], "uplink: expected the bytes of a message"),
        (["factory", "--downlink", "-4kB"], "expected one argument"),
        (["factory", "--downlink", "40 kilo"], "downlink: expected the bytes of a message"),
    ],
)
def test_a_bad_flag_is_one_line(flags, message, refused):
    assert message in refused(*flags)


def test_a_folder_that_cannot_be_written_is_one_line(tmp_path, refused):
    (tmp_path / "file").write_text("")
    message = refused("factory", "--count", "1", "--out", str(tmp_path / "file"))
    assert "out: cannot make folder" in message


@pytest.mark.parametrize(
    ("text", "expected"), [("1000B", 1_000), ("40kB", 40_000), ("1MB", 1_000_000), ("250", 250)]
)
def test_bytes_are_read_with_their_unit(text, expected):
    assert parse_bytes("uplink", text) == expected


def test_a_message_too_large_for_any_link_is_refused():
    with pytest.raises(ConfigError, match="to 10MB, got '11MB'"):
        parse_bytes("downlink", "11MB")


@pytest.fixture
def command(monkeypatch):
    """The command line, run to its end."""
    commands = (Subcommand("generate", "", "netem.generator.generate"),)

    def call(*flags):
        monkeypatch.setattr("sys.argv", ["netem", "generate", *flags])
        with pytest.raises(SystemExit) as ended:
            run(lambda: run_command(None, commands))
        return ended.value.code

    return call


@pytest.fixture
def refused(command, capsys, monkeypatch, tmp_path):
    """Its one line on standard error."""

    # A refused command makes no folder.
    monkeypatch.chdir(tmp_path)

    def call(*flags):
        assert command(*flags) == 2
        assert not any(path.is_dir() for path in tmp_path.iterdir())
        error = capsys.readouterr().err
        assert error.count("\n") == 1
        return error

    return call
