"""What a recording is told on its command line, and one line for what it cannot be."""

from __future__ import annotations

from pathlib import Path

import pytest

from netem.networks import load_profile
from netem.recorder.record import _keep
from shared.process.cli import Subcommand, run, run_command

NEAR = ("--connect", "tcp/127.0.0.1:1")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (NEAR, "out: expected a file for the profile"),
        ((*NEAR, "--out", "x.dat"), "ends in .npz or .csv"),
        ((*NEAR, "--out", "/proc/x.npz"), "out: cannot write"),
        ((*NEAR, "--out", "x.npz", "--rate", "1e6"), "rate: expected from 10 to 5000"),
        ((*NEAR, "--out", "x.npz", "--uplink", "1MB"), "uplink: expected a size from"),
        ((*NEAR, "--out", "x.npz", "--seconds", "0"), "seconds: expected from 0.1"),
        (("--listen", "tcp/127.0.0.1:1", "--seconds", "5"), "seconds: expected beside --connect"),
        (("--listen", "tcp/127.0.0.1:1", *NEAR), "not allowed with"),
        ((), "one of the arguments --listen --connect is required"),
    ],
)
def test_a_mistake_is_one_line(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    options: tuple[str, ...],
    message: str,
) -> None:
    # Away from the project's folder, should a file be written after all.
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["netem", "record", *options])
    commands = (Subcommand("record", "", "netem.recorder.record"),)
    with pytest.raises(SystemExit) as ended:
        run(lambda: run_command(None, commands))
    assert ended.value.code == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert message in captured.err
    assert list(tmp_path.iterdir()) == []


def test_a_measurement_for_which_its_disk_has_no_room_is_kept_elsewhere(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    (tmp_path / "full").write_text("no folder")
    profile = load_profile("constant:8ms")
    kept = _keep(profile, tmp_path / "full/mylink.npz")
    assert load_profile(str(kept)).delays_ns.tolist() == profile.delays_ns.tolist()
    (line,) = capsys.readouterr().out.splitlines()
    assert line.startswith("warning: profile")
    assert line.endswith(f"the profile is in {kept}")
    assert _keep(profile, tmp_path / "mylink.npz") == tmp_path / "mylink.npz"
