"""A user's mistake is one line, in every command that takes the input."""

from __future__ import annotations

import functools
import io
import os
import resource
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from netem.networks import load_profile
from remote_wbc import commands
from shared.bus.zenoh_bus import ZenohBus
from shared.errors import ConfigError, LinkError, UserError, writing
from shared.process.cli import command_parser, run
from shared.regular_file import read_regular
from shared.toml_file import read_toml
from tests.processes import Typed

# Every command that takes a file of settings, and every one that takes a profile.
WITH_SETTINGS = (
    ("trial", "--config"),
    ("config", "--config"),
    ("up", "--config"),
    ("atlas", "--config"),
    ("netem", "replay", "constant:10ms", "--config"),
    ("netem", "packets", "constant:10ms", "--config"),
    ("viewer", "live", "--telemetry", "tcp/127.0.0.1:1", "--config"),
)
WITH_PROFILE = (
    ("trial", "--network"),
    ("up", "--network"),
    ("link",),
    ("netem", "show"),
    ("netem", "stats"),
    ("netem", "replay"),
)
WITH_NAME = (
    ("up", "--name"),
    ("ps", "--name"),
    ("logs", "--name"),
    ("down", "--name"),
    ("restart", "edge", "--name"),
    ("netem", "record", "--connect", "tcp/127.0.0.1:1", "--out", "x.npz", "--name"),
    ("netem", "replay", "--name"),
)


def play(*arguments: str) -> None:
    """Run a command of `wbc` in this process."""
    parser = command_parser("", commands(), typed=list(arguments))
    parsed = parser.parse_args(arguments)
    parsed.run_command(parsed)


def mistake(*arguments: str) -> str:
    """The error of a command, which is one line and not long."""
    with pytest.raises(UserError) as raised:
        play(*arguments)
    text = str(raised.value)
    assert "\n" not in text
    assert len(text) < 600
    return text


def a_pipe(path: Path) -> None:
    os.mkfifo(path)


def a_device(path: Path) -> None:
    path.symlink_to("/dev/zero")


def a_folder(path: Path) -> None:
    path.mkdir()


def a_link_to_itself(path: Path) -> None:
    path.symlink_to(path)


def text(content: str | bytes) -> Callable[[Path], object]:
    """A maker of a file with this content."""
    data = content.encode() if isinstance(content, str) else content
    return lambda path: path.write_bytes(data)


BAD_SETTINGS = {
    "a pipe": (a_pipe, "expected a regular file, got a pipe"),
    "a device": (a_device, "expected a regular file, got a device"),
    "a folder": (a_folder, "Is a directory"),
    "a link to itself": (a_link_to_itself, "Too many levels"),
    "deep lists": (text("a=" + "[" * 100_000 + "]" * 100_000), "at most 30 levels"),
    "deep tables": (text("a=" + "{b=" * 3000 + "1" + "}" * 3000), "at most 30 levels"),
    "31 levels": (text("a=" + "[" * 31 + "]" * 31), "at most 30 levels"),
    "a deep key": (text(".".join("a" * 20_000) + "=1"), "at most 30 levels"),
    "a deep name of a table": (text("[" + " . ".join("a" * 20_000) + "]"), "at most 30 levels"),
    "much": (text("# " + "x" * 1_000_000), "at most 1 MB"),
    "zeros": (text(bytes(100)), "not valid TOML"),
    "another encoding": (text('task = "walk"'.encode("utf-16")), "not valid TOML"),
}


@pytest.mark.parametrize("command", WITH_SETTINGS, ids=" ".join)
@pytest.mark.parametrize(("make", "expected"), BAD_SETTINGS.values(), ids=BAD_SETTINGS)
def test_settings_that_are_no_settings(command, make, expected, tmp_path: Path):
    make(tmp_path / "settings.toml")
    assert expected in mistake(*command, str(tmp_path / "settings.toml"))


@pytest.mark.parametrize("content", ["a.b.c = [[1, 2], [3]]", "x = 1.5\r\ny = '1.2.3.4'\r\n"])
def test_settings_of_a_few_levels_are_read(content: str, tmp_path: Path):
    (tmp_path / "settings.toml").write_text("\ufeff" + content, encoding="utf-8", newline="")
    assert read_toml(tmp_path / "settings.toml", what="settings")


def an_archive(shape: tuple[int, ...], n_bytes: int = 0) -> Callable[[Path], object]:
    """A maker of a profile whose arrays claim `shape` and have `n_bytes` bytes."""

    @functools.cache
    def packed() -> bytes:
        header, content = io.BytesIO(), io.BytesIO()
        claim = {"descr": "<i8", "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(header, claim)
        with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
            for way in ("uplink_us", "downlink_us"):
                archive.writestr(f"{way}.npy", header.getvalue() + bytes(n_bytes))
        return content.getvalue()

    return lambda path: path.write_bytes(packed())


BAD_PROFILES = {
    "a claim of much": (an_archive((2**45,)), "expected the claimed 2.815e+14 bytes"),
    "a claim of more than there is": (an_archive((1000, 1000)), "expected the claimed 8e+06 bytes"),
    "a claim of less than nothing": (an_archive((-5,)), "expected arrays"),
    "much, packed": (an_archive((25_000_000,), 200_000_000), "and at most 1.6e+08"),
    "no archive": (text("PK"), "expected arrays uplink_us and downlink_us"),
    "a pipe": (a_pipe, "no such profile or file"),
    "a device": (a_device, "no such profile or file"),
    "a link to itself": (a_link_to_itself, "no such profile or file"),
}


@pytest.mark.parametrize("command", WITH_PROFILE, ids=" ".join)
@pytest.mark.parametrize(("make", "expected"), BAD_PROFILES.values(), ids=BAD_PROFILES)
def test_profiles_that_are_none(command, make, expected, tmp_path: Path):
    make(tmp_path / "mine.npz")
    assert expected in mistake(*command, str(tmp_path / "mine.npz"))


def test_a_profile_in_text_may_begin_with_a_byte_order_mark(tmp_path: Path):
    content = "\ufeffuplink_ms,downlink_ms\n1,2\n"
    (tmp_path / "mine.csv").write_text(content, encoding="utf-8")
    assert load_profile(str(tmp_path / "mine.csv")).delays_ns.tolist() == [[10**6], [2 * 10**6]]


@pytest.mark.parametrize("suffix", ["npz", "csv"])
def test_metadata_of_many_levels_is_no_traceback(suffix: str, tmp_path: Path):
    path, deep = tmp_path / f"mine.{suffix}", "[" * 100_000
    if suffix == "npz":
        delays = np.ones(3, dtype=np.int64)
        np.savez(path, uplink_us=delays, downlink_us=delays, meta=np.array(deep))
        assert "expected arrays" in mistake("netem", "stats", str(path))
    else:
        path.write_text(f"# notes: {deep}\nuplink_ms,downlink_ms\n1,2\n")
        assert load_profile(str(path)).metadata["notes"] == deep


@pytest.mark.parametrize("make", [a_pipe, a_device, a_folder, a_link_to_itself])
def test_measurements_that_are_no_file(make, tmp_path: Path):
    make(tmp_path / "measured")
    assert "cannot read it" in mistake(
        "netem", "convert", str(tmp_path / "measured"), str(tmp_path / "out.npz")
    )


@pytest.mark.parametrize("command", WITH_NAME, ids=" ".join)
@pytest.mark.parametrize("name", ["", " ", "a/b", "A"])
def test_a_name_that_no_robot_can_have(command, name: str):
    assert "name: expected small letters" in mistake(*command, name)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("up --colour red", "unrecognized arguments"),
        ("up --network no/such", "expected a shipped profile"),
        ("up --config absent.toml", "cannot read absent.toml"),
        ("up --push hard", "push: expected"),
        ("up --only edge,robots", "edge, netem, robot, viewer, router"),
        ("up --only robot", "--edge tls/HOST:7460"),
        ("up --secure /nonexistent", "wbc keys /nonexistent"),
    ],
)
def test_a_mistake_on_the_command_line_is_one_line(typed: Typed, words: str, expected: str):
    done = typed(*words.split())
    assert (done.returncode, done.stdout) == (2, "")
    (line,) = done.stderr.splitlines()
    assert expected in line


def test_a_bad_line_of_a_trace_is_named(tmp_path: Path):
    (tmp_path / "mine.csv").write_text("uplink_ms,downlink_ms\n1.5,1.7\n1.5,soon\n")
    assert "line 3" in mistake("netem", "replay", str(tmp_path / "mine.csv"))


@pytest.mark.parametrize("command", ["trial", "up"])
def test_more_steps_than_can_be_planned(command: str):
    found = mistake(command, "--task", "walk", "--steps", "100000000")
    assert found == "walk.steps: expected a number ≥ 1 and ≤ 1000, got 100000000"


@pytest.mark.parametrize(
    "command",
    [
        *(("trial", "--out"), ("up", "--out"), ("keys",), ("netem", "generate", "factory")),
        *(("viewer", "open"), ("viewer", "record"), ("ps", "--run"), ("logs", "--run")),
    ],
    ids=" ".join,
)
def test_a_folder_that_is_a_link_to_itself(command, tmp_path: Path):
    a_link_to_itself(tmp_path / "loop")
    if command[-1] == "factory":
        command = (*command, "--out")
    assert "loop" in mistake(*command, str(tmp_path / "loop"))


def test_an_error_without_the_name_of_a_file_names_the_folder(tmp_path: Path):
    with (
        pytest.raises(ConfigError, match=rf"out: cannot write {tmp_path}: No space left on device"),
        writing(tmp_path, what="out"),
        open("/dev/full", "wb") as full,
    ):
        full.write(b"much" * 10_000)


def test_a_file_of_bounded_size_is_read_whole(tmp_path: Path):
    (tmp_path / "file").write_bytes(b"12345")
    assert read_regular(tmp_path / "file", at_most=5) == b"12345"
    with pytest.raises(OSError, match="expected at most") as raised:
        read_regular(tmp_path / "file", at_most=4)
    assert raised.value.filename == str(tmp_path / "file")


@pytest.mark.parametrize(
    ("error", "expected"),
    [
        (MemoryError(), "error: expected more memory than this process may have"),
        (OSError(24, "Too many open files"), "error: the system refuses: Too many open files"),
        (OSError(13, "Permission denied", "/x"), "error: /x: Permission denied"),
    ],
)
def test_what_the_machine_refuses_is_one_line(error, expected: str, capsys):
    def fails() -> int:
        raise error

    with pytest.raises(SystemExit) as ended:
        run(fails)
    assert ended.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(expected)


@pytest.mark.parametrize(
    ("limit", "value", "expected"),
    [
        (resource.RLIMIT_NOFILE, 20, "at least 100 open files, got 20; raise it: ulimit -n 1024"),
        (resource.RLIMIT_AS, 1 << 30, "at least 2 GiB of address space, got 1; raise it"),
    ],
)
def test_limits_under_which_no_session_works(limit, value, expected, monkeypatch):
    getrlimit = resource.getrlimit
    monkeypatch.setattr(
        resource,
        "getrlimit",
        lambda which: (value, value) if which == limit else getrlimit(which),
    )
    with pytest.raises(LinkError, match=expected):
        ZenohBus(connect=["tcp/127.0.0.1:1"])
