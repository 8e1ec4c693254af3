"""The flood of commands comes in its own spans, and never in a quiet one."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import pytest

from benchmarks import flood
from deploy.background.state import StackFolder
from shared.errors import LinkError
from shared.wire.operator.commands import Accepted, Command, Go


def test_commands_come_in_flooded_spans_only(monkeypatch: pytest.MonkeyPatch) -> None:
    sent_ns: list[int] = []

    class Client:
        def __init__(self, stack: StackFolder) -> None:
            pass

        def send(self, command: Command) -> Accepted:
            sent_ns.append(time.monotonic_ns())
            # A stack answers no faster.
            threading.Event().wait(0.002)
            if isinstance(command, Go):
                raise LinkError("refused")
            return Accepted(0, "")

    monkeypatch.setattr(flood, "StackClient", Client)
    quiet, flooded, sent = flood._flood(StackFolder(Path("run")), rounds=3, seconds=0.05)
    assert len(quiet) == len(flooded) == 3
    assert sent == len(sent_ns) > 0
    assert not any(begin <= at < end for begin, end in quiet for at in sent_ns)
    for begin, end in flooded:
        assert any(begin <= at < end for at in sent_ns)
