from __future__ import annotations

import gc
import hashlib
import io
import warnings
import zipfile

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from netem.networks import SHIPPED, load_profile, shipped_names
from netem.profile import DOWNLINK, LOST, UPLINK, DelayProfile, worst_outage
from shared.errors import ProfileError

MS = 1_000_000
HEADER = "uplink_ms,downlink_ms\n"


@pytest.fixture
def csv_file(tmp_path):
    def write(text):
        path = tmp_path / "trace.csv"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return str(path)

    return write


@pytest.fixture
def npz_file(tmp_path):
    def write(**arrays):
        path = tmp_path / "trace.npz"
        np.savez_compressed(path, **arrays)
        return str(path)

    return write


def message_of(network):
    with pytest.raises(ProfileError) as error:
        load_profile(network)
    message = str(error.value)
    assert "\n" not in message
    return message


@pytest.mark.parametrize("name", shipped_names())
def test_every_shipped_profile_loads_under_its_name(name):
    profile = load_profile(name)
    assert profile.name == name
    assert profile.delays_ns.dtype == np.int64
    assert profile.delays_ns.shape == (2, 6000)
    assert profile.metadata["scenario"] in name
    passed = profile.delays_ns[profile.delays_ns != LOST]
    # One-way delays in ns: the link's floor is 1 ms and nothing waits longer than the run.
    assert 1 * MS <= passed.min() < passed.max() < 6000 * MS


def test_shipped_profiles_are_those_of_the_manifest():
    manifest = {}
    for line in (SHIPPED / "SHA256SUMS").read_text().splitlines():
        digest, name = line.split()
        manifest[name.removesuffix(".npz")] = digest
    assert sorted(manifest) == shipped_names()
    for name, digest in manifest.items():
        assert hashlib.sha256((SHIPPED / f"{name}.npz").read_bytes()).hexdigest() == digest, name


def test_an_unknown_name_is_refused_with_examples_of_every_form():
    message = message_of("factory/999")
    assert "'factory/999'" in message
    for example in ("factory/001", "building/001", ".npz", ".csv", "constant:30ms", "direct"):
        assert example in message


def test_a_name_too_long_for_a_file_is_refused():
    assert "no such profile" in message_of("x" * 300)


def test_a_file_of_another_kind_is_refused(tmp_path):
    path = tmp_path / "trace.txt"
    path.write_text(HEADER + "1,2\n")
    assert ".npz or .csv" in message_of(str(path))


@pytest.mark.parametrize(
    ("text", "up_ns", "down_ns"),
    [
        ("constant:30ms", 15 * MS, 15 * MS),
        ("constant:0ms", 0, 0),
        ("constant:10ms/20ms", 10 * MS, 20 * MS),
        ("constant:0ms/1s", 0, 1000 * MS),
        ("constant:1.5s", 750 * MS, 750 * MS),
        ("constant:500us", 250_000, 250_000),
        ("constant:0.001us", 0, 1),
    ],
)
def test_a_constant_round_trip_is_halved_and_two_delays_are_up_and_down(text, up_ns, down_ns):
    profile = load_profile(text)
    assert profile.name == text
    for elapsed_ns in (0, 1, 7 * MS, 10**12):
        assert profile.delay_ns(UPLINK, elapsed_ns) == up_ns
        assert profile.delay_ns(DOWNLINK, elapsed_ns) == down_ns
    assert profile.nominal_round_trip_ns == up_ns + down_ns


@given(microseconds=st.integers(0, 10**7))
def test_the_halves_of_a_constant_add_up_to_the_round_trip(microseconds):
    profile = load_profile(f"constant:{microseconds}us")
    assert int(profile.delays_ns.sum()) == 1000 * microseconds


@pytest.mark.parametrize(
    "text",
    [
        "constant:",
        "constant:30",
        "constant:-5ms",
        "constant:5 ms each",
        "constant:1ms/",
        "constant:1ms/2ms/3ms",
        "constant:nanms",
        "constant:99999999999s",
        "constant:" + "9" * 400 + "s",
    ],
)
def test_a_constant_that_is_no_duration_is_refused(text):
    assert "constant" in message_of(text)


def test_a_csv_has_a_row_per_millisecond(csv_file):
    profile = load_profile(csv_file(HEADER + "1.5,2\n lost , 3.25\n0,0\n"))
    assert profile.name == "trace"
    assert profile.delays_ns.tolist() == [[1_500_000, LOST, 0], [2 * MS, 3_250_000, 0]]
    assert profile.duration_ns == 3 * MS
    assert profile.delay_ns(UPLINK, 999_999) == 1_500_000
    assert profile.delay_ns(UPLINK, 1 * MS) == LOST
    assert profile.delay_ns(DOWNLINK, 4 * MS) == 3_250_000


def test_a_csv_may_have_blank_lines_and_other_line_ends(csv_file):
    profile = load_profile(csv_file("uplink_ms, downlink_ms\r\n1,2\r\n\r\n3,4\r\n"))
    assert profile.delays_ns.tolist() == [[1 * MS, 3 * MS], [2 * MS, 4 * MS]]


@pytest.mark.parametrize(
    "row",
    [
        "1",
        "1,2,3",
        "1,x",
        "1,",
        "-1,2",
        "1,-0.5",
        "1,-0.000001",
        "nan,2",
        "inf,2",
        "1,LOST",
        "1;2",
        "1,\0",
        "1e300,2",
        "1,1e13",
    ],
)
def test_a_bad_row_of_a_csv_is_named_with_its_line(csv_file, row):
    message = message_of(csv_file(HEADER + "1,2\n3,4\n" + row + "\n5,6\n"))
    assert "trace.csv, line 4:" in message
    assert repr(row)[1:-1].split(",")[0] in message


def test_line_numbers_count_the_lines_of_the_file(csv_file):
    message = message_of(csv_file(HEADER + '\n\n"1\n",2\n1,bad\n'))
    assert "line 6:" in message


@pytest.mark.parametrize("header", ["", "1,2\n", "uplink,downlink\n", "downlink_ms,uplink_ms\n"])
def test_a_csv_without_its_header_is_refused_at_line_one(csv_file, header):
    message = message_of(csv_file(header + "1,2\n"))
    assert "line 1:" in message
    assert "uplink_ms,downlink_ms" in message


def test_a_csv_without_rows_is_refused(csv_file):
    assert "at least one row" in message_of(csv_file(HEADER))


def test_a_csv_that_is_no_text_is_refused(csv_file):
    assert "expected text, got" in message_of(csv_file(HEADER.encode() + bytes(range(128, 256))))


@pytest.mark.parametrize("row", ["lost,1", "1,lost"])
def test_a_direction_that_loses_everything_is_refused(csv_file, row):
    message = message_of(csv_file(HEADER + f"{row}\n{row}\n"))
    assert ("uplink" if row.startswith("lost") else "downlink") in message


def test_an_npz_holds_microseconds(npz_file):
    file = npz_file(
        uplink_us=np.array([1500, -1], dtype=np.int32),
        downlink_us=np.array([2, 3_000_000], dtype=np.int32),
    )
    profile = load_profile(file)
    assert profile.delays_ns.tolist() == [[1_500_000, LOST], [2_000, 3_000_000_000]]
    assert profile.metadata == {}


GOOD = np.array([1000, 2000, 3000])


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({"uplink_us": GOOD}, ["uplink_us and downlink_us"]),
        ({"other": GOOD}, ["uplink_us and downlink_us"]),
        ({"uplink_us": GOOD, "downlink_us": GOOD[:2]}, ["equal length", "(3,)", "(2,)"]),
        ({"uplink_us": GOOD[None], "downlink_us": GOOD[None]}, ["(1, 3)"]),
        ({"uplink_us": np.array(3), "downlink_us": np.array(4)}, ["()"]),
        ({"uplink_us": GOOD[:0], "downlink_us": GOOD[:0]}, ["(0,)"]),
        (
            {"uplink_us": GOOD, "downlink_us": np.array([5, -2, 7])},
            ["downlink_us[1]: expected a delay", "µs", "got -2"],
        ),
        (
            {"uplink_us": np.array([-1, -1, -1]), "downlink_us": GOOD},
            ["expected uplink messages that arrive, got only lost ones"],
        ),
        ({"uplink_us": np.array(["a", "b", "c"]), "downlink_us": GOOD}, ["uplink_us"]),
        ({"uplink_us": np.array([1, None, 2]), "downlink_us": GOOD}, ["uplink_us"]),
        ({"uplink_us": np.array([1.0, np.nan, 2.0]), "downlink_us": GOOD}, ["uplink_us"]),
        ({"uplink_us": np.array([1.0, np.inf, 2.0]), "downlink_us": GOOD}, ["uplink_us"]),
        ({"uplink_us": GOOD, "downlink_us": GOOD, "meta": "{"}, ["trace.npz"]),
    ],
    ids=[
        "one way missing",
        "both missing",
        "unequal length",
        "two dimensions",
        "no dimension",
        "empty",
        "negative",
        "all lost",
        "text",
        "objects",
        "not a number",
        "infinite",
        "bad metadata",
    ],
)
def test_a_bad_npz_is_refused_with_what_was_expected(npz_file, arrays, words):
    message = message_of(npz_file(**arrays))
    for word in words:
        assert word in message


def test_a_delay_beyond_what_time_can_hold_is_refused_and_not_wrapped(npz_file):
    # In ns it exceeds 63 bits: wrapped, it would be negative and a message early.
    message_of(npz_file(uplink_us=np.array([10**17]), downlink_us=np.array([1000])))


def test_a_single_array_under_the_name_of_an_npz_is_refused(tmp_path):
    path = tmp_path / "trace.npz"
    with path.open("wb") as file:
        np.save(file, GOOD)
    assert "uplink_us and downlink_us" in message_of(str(path))


@pytest.mark.parametrize("content", [b"", b"hello", b"PK\x03\x04", bytes(1000)])
def test_a_file_that_is_no_archive_is_refused(tmp_path, content):
    path = tmp_path / "trace.npz"
    path.write_bytes(content)
    assert "trace.npz" in message_of(str(path))


def test_a_whole_archive_of_a_damaged_array_is_refused(tmp_path):
    # The archive's checksums hold; it is NumPy's header inside that has lost a bracket.
    buffer = io.BytesIO()
    np.save(buffer, GOOD)
    path = tmp_path / "trace.npz"
    with zipfile.ZipFile(path, "w") as archive:
        for name in ("uplink_us", "downlink_us"):
            archive.writestr(f"{name}.npy", buffer.getvalue().replace(b"(3,)", b"(3, "))
    assert "uplink_us and downlink_us" in message_of(str(path))


def test_a_refused_file_is_closed(tmp_path):
    path = tmp_path / "trace.npz"
    good = (SHIPPED / "factory" / "001.npz").read_bytes()
    path.write_bytes(good[: len(good) // 2])
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        message_of(str(path))
        gc.collect()
    assert not [str(each.message) for each in caught]


def test_a_truncated_or_damaged_npz_is_refused_or_still_whole(tmp_path, rng):
    good = (SHIPPED / "factory" / "001.npz").read_bytes()
    path = tmp_path / "trace.npz"
    refused = 0
    for k in range(600):
        if k % 3 == 0:
            data = good[: rng.integers(len(good))]
        else:
            # Anywhere in the compressed numbers, or in the directory at the end of the archive.
            start = 0 if k % 3 == 1 else len(good) - 600
            damaged = bytearray(good)
            damaged[rng.integers(start, len(good))] ^= 1 << rng.integers(8)
            data = bytes(damaged)
        path.write_bytes(data)
        try:
            delays_ns = load_profile(str(path)).delays_ns
        except ProfileError:
            refused += 1
        else:
            assert delays_ns.min() >= LOST
    # All 200 truncations, and damage to the two arrays or to the directory.
    assert refused > 200


def test_a_seed_chooses_where_a_run_begins():
    profile = load_profile("factory/001")
    offsets = [profile.start_offset_ns(seed) for seed in range(20)]
    assert offsets == [profile.start_offset_ns(seed) for seed in range(20)]
    assert len(set(offsets)) > 15
    assert all(0 <= offset < profile.duration_ns for offset in offsets)
    assert all(offset % profile.period_ns == 0 for offset in offsets)


def test_the_nominal_round_trip_leaves_losses_out():
    delays = np.array([[LOST, 2, 4, 6], [LOST, LOST, LOST, 10]])
    assert DelayProfile("test", delays).nominal_round_trip_ns == 4 + 10


def test_the_worst_outage_is_the_longest_time_without_arrivals_also_across_the_end():
    delays_ns = np.full((2, 100), 5 * MS)
    delays_ns[UPLINK, 40:48] = LOST
    # The second of two late messages overtakes nothing: 30 ms pass until both arrive.
    delays_ns[UPLINK, 60:90] = (35 - np.arange(30)) * MS
    assert worst_outage(DelayProfile("x", delays_ns)) == {
        "direction": "uplink",
        "ms": 30.0,
        "at_s": 0.065,
    }
    delays_ns[DOWNLINK, -20:] = delays_ns[DOWNLINK, :20] = LOST
    assert worst_outage(DelayProfile("x", delays_ns)) == {
        "direction": "downlink",
        "ms": 40.0,
        "at_s": 0.085,
    }
    steady = DelayProfile("x", np.full((2, 100), 5 * MS))
    assert worst_outage(steady) == {"direction": None, "ms": 0.0, "at_s": None}
