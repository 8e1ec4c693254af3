from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from netem.profile import LOST, DelayProfile
from netem.profile_file import read_profile, write_profile
from shared.errors import ProfileError

MS = 1_000_000
DELAYS_US = st.one_of(st.just(LOST), st.integers(0, 2_000_000))


def profile_of(delays_us, **fields):
    delays = np.array(delays_us, dtype=np.int64).T
    return DelayProfile("mine", np.where(delays == LOST, LOST, delays * 1000), **fields)


def message_of(path):
    with pytest.raises(ProfileError) as error:
        read_profile(path)
    message = str(error.value)
    assert "\n" not in message
    assert path.name in message
    return message


def test_a_byte_order_mark_does_not_matter(tmp_path):
    path = tmp_path / "a.csv"
    path.write_bytes("\ufeff# scenario: my lab\nuplink_ms,downlink_ms\n1,2\n".encode())
    assert read_profile(path).metadata["scenario"] == "my lab"


@pytest.mark.parametrize("suffix", [".npz", ".csv"])
@settings(max_examples=25, deadline=None)
@given(delays=st.lists(st.tuples(DELAYS_US, DELAYS_US), min_size=1, max_size=30))
def test_what_is_written_is_read(tmp_path_factory, suffix, delays):
    n = len(delays)
    known = [(0, 0), *delays]  # a way that loses everything is no profile
    written = profile_of(
        known,
        period_ns=2 * MS,
        metadata={"scenario": 'my lab: "1", 2', "seed": 3, "notes": ["a", "b"]},
        columns={"uplink_capacity_bytes": np.linspace(0, 1e5, n + 1)},
    )
    path = tmp_path_factory.mktemp("profile") / f"mine{suffix}"
    write_profile(written, path)
    read = read_profile(path)
    assert read.name == "mine"
    assert read.period_ns == 2 * MS
    np.testing.assert_array_equal(read.delays_ns, written.delays_ns)
    assert {**written.metadata, "period_us": 2000.0} == {
        key: value for key, value in read.metadata.items() if key != "source"
    }
    np.testing.assert_allclose(
        read.columns["uplink_capacity_bytes"], written.columns["uplink_capacity_bytes"], rtol=1e-9
    )


def test_a_file_is_written_whole_or_not_at_all(tmp_path):
    path = tmp_path / "sub" / "mine.npz"
    write_profile(profile_of([(1, 2)]), path)
    before = path.read_bytes()
    (tmp_path / "wall").write_text("")
    with pytest.raises(ProfileError, match="cannot write"):
        write_profile(profile_of([(3, 4)]), tmp_path / "wall" / "mine.npz")
    assert path.read_bytes() == before
    assert [file.name for file in path.parent.iterdir()] == ["mine.npz"]


def test_a_name_of_another_kind_is_refused(tmp_path):
    with pytest.raises(ProfileError, match=r"\.npz or \.csv"):
        write_profile(profile_of([(1, 2)]), tmp_path / "mine.txt")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("uplink_ms,downlink_ms,x\n1,2\n", "line 2: expected 3 values"),
        ("uplink_ms,downlink_ms,x\n1,2,three\n", "line 2: expected numbers in the further"),
        ("# period_us: 0\nuplink_ms,downlink_ms\n1,2\n", "period_us: expected from 1"),
        ("# period_us: soon\nuplink_ms,downlink_ms\n1,2\n", "period_us: expected from 1"),
        ("# a: 1\n# b: 2\nup,down\n1,2\n", "line 3: expected the header uplink_ms,downlink_ms"),
        ("# only: metadata\n", "expected the header uplink_ms,downlink_ms"),
        (
            "uplink_ms,downlink_ms,uplink_capacity_bytes\n1,2,-5\n",
            "uplink_capacity_bytes: expected numbers of bytes of 0 or more",
        ),
    ],
)
def test_a_wrong_csv_file_is_refused_with_its_line(tmp_path, text, expected):
    path = tmp_path / "mine.csv"
    path.write_text(text)
    assert expected in message_of(path)


@pytest.mark.parametrize(
    ("arrays", "expected"),
    [
        ({"meta": np.array("[1, 2]")}, "expected meta to be a JSON object"),
        ({"meta": np.array(json.dumps({"period_us": -1}))}, "period_us: expected"),
        ({"sinr": np.zeros(3)}, "sinr: expected 2 numbers"),
        ({"sinr": np.array(["a", "b"])}, "sinr: expected 2 numbers"),
    ],
)
def test_a_wrong_npz_file_is_refused_with_its_array(tmp_path, arrays, expected):
    path = tmp_path / "mine.npz"
    np.savez(path, uplink_us=np.array([1, 2]), downlink_us=np.array([1, 2]), **arrays)
    assert expected in message_of(path)


def test_a_file_that_may_not_be_read_is_named(tmp_path):
    message = message_of(tmp_path / "nothing.npz")
    assert "No such file" in message
