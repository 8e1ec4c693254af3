from __future__ import annotations

import functools
import json

import pytest


@pytest.fixture
def netem(typed):
    return functools.partial(typed, "netem")


def test_a_list_has_a_line_per_profile(netem):
    done = netem("list", "factory-strong-signal")
    assert done.returncode == 0, done.stderr
    assert [line.split()[0] for line in done.stdout.splitlines()[1:]] == [
        f"factory-strong-signal/{k:03}" for k in range(1, 9)
    ]
    # 1.2 s of outage in the second.
    assert "1240.1 ms" in done.stdout.splitlines()[2]


def test_a_profile_is_shown_and_drawn(netem, tmp_path):
    picture = tmp_path / "new" / "profile.png"
    done = netem("show", "factory/011", "--plot", str(picture))
    assert done.returncode == 0, done.stderr
    assert "6000 periods" in done.stdout
    assert '"factory"' in done.stdout
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_statistics_of_a_folder_are_those_of_its_files_together(netem, tmp_path):
    for name, delay in (("a", 1.0), ("b", 3.0)):
        (tmp_path / f"{name}.csv").write_text(f"uplink_ms,downlink_ms\n{delay},{delay}\n")
    done = netem("stats", "--json", str(tmp_path))
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["profiles"] == ["a", "b"]
    assert result["uplink"]["median"] == 2.0
    assert result["round trip"]["maximum"] == 6.0
    assert result["uplink"]["peak_median"] is None


def test_statistics_explain_their_labels(netem):
    done = netem("stats", "constant:10ms")
    assert done.returncode == 0, done.stderr
    for label in ("spike:", "peak:", "memory:", "lost:", "round trip:"):
        assert label in done.stdout
    assert "nan" not in done.stdout


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("list", "moon"), "expected one of building, factory"),
        (("show", "factory/999"), "no such profile"),
        (("stats", "factory/001", "nothing.npz"), "no such profile"),
        (("show", "factory/001", "--plot", "/proc/x/y.png"), "cannot write"),
        (("show",), "required: NAME"),
        ((), "required: COMMAND"),
        (("replay", "direct"), "direct means no shim"),
    ],
)
def test_a_mistake_is_one_line(netem, arguments, expected):
    done = netem(*arguments)
    assert done.returncode == 2
    assert expected in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


def test_an_empty_folder_is_refused(netem, tmp_path):
    done = netem("stats", str(tmp_path))
    assert done.returncode == 2
    assert "found none" in done.stderr
