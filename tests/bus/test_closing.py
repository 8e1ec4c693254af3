"""The close of a bus never raises: the results come first, and nothing may hide them."""

from __future__ import annotations

import threading

import pytest

from shared.bus.zenoh_bus import ZenohBus


def test_a_bus_is_left_open_if_there_is_no_memory_for_another_thread(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fail(thread: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", fail)
    # Its session is never asked for.
    ZenohBus.__new__(ZenohBus).close()
