"""What is said where a packet-level link is not to be had; `tests/live` has the rest."""

from __future__ import annotations

from pathlib import Path

import pytest

from netem.tun import NamespacePair, why_not_permitted
from shared.errors import LinkError


def test_without_root_root_is_what_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.geteuid", lambda: 1000)
    # Whatever else is missing, nothing of it can be mended by another than root.
    monkeypatch.setattr("shutil.which", lambda name: None)
    with pytest.raises(LinkError, match="need root; try sudo"):
        NamespacePair(robot="a", edge="b", mtu=1500).__enter__()


def test_the_missing_command_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.geteuid", lambda: 0)
    monkeypatch.setattr("shutil.which", lambda name: None)
    missing = why_not_permitted()
    assert missing is not None
    assert "iproute2" in missing


def test_the_missing_device_is_named_with_what_makes_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("os.geteuid", lambda: 0)
    monkeypatch.setattr("shutil.which", lambda name: f"/sbin/{name}")
    monkeypatch.setattr("netem.tun._TUN", tmp_path / "tun")
    missing = why_not_permitted()
    assert missing is not None
    assert "modprobe tun" in missing


def test_another_system_is_told_that_it_takes_linux(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.platform", "darwin")
    missing = why_not_permitted()
    assert missing is not None
    assert "need Linux" in missing
