"""The live path: the queue, what cannot be opened, and a run watched from start to stop."""

from __future__ import annotations

import os
import signal
import socket
import time
from pathlib import Path

import numpy as np
import pytest

from shared.bus.zenoh_bus import ZenohBus
from shared.config.config_file import dump_config
from shared.config.settings import RunConfig
from shared.errors import LinkError, UserError
from shared.robots import Robot
from shared.telemetry.row_log import encode_rows
from shared.wire.channels import LINK_KEY, STEPS_KEY, TICKS_KEY
from tests.processes import PATIENCE_SECONDS, Process, until
from tests.telemetry_hub import is_heard
from tests.viewer.reading import logged
from tests.viewer.synthetic import link_rows, step_rows, tick_rows
from viewer.blueprint import layout
from viewer.display import Display
from viewer.intake import BlockQueue, connect
from viewer.recording import new_recording
from viewer.rerun_process import free_port

LAYOUT = layout(RunConfig(), duration=None)


def test_a_full_queue_drops_its_oldest_blocks_and_counts_them() -> None:
    blocks = BlockQueue(limit=3)
    for number in range(5):
        blocks.put(bytes([number]))
    assert blocks.dropped == 2
    assert blocks.take() == [b"\x02", b"\x03", b"\x04"]
    assert blocks.take() == []


def test_a_missing_hub_is_one_line_that_names_the_endpoint() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with pytest.raises(LinkError, match=f"no hub answers at {endpoint}"):
        connect(endpoint, stopped=lambda: False, timeout=0.0)


def test_a_malformed_endpoint_is_told_by_example() -> None:
    with pytest.raises(LinkError, match=r"expected PROTOCOL/HOST:PORT as in tcp/"):
        connect("nonsense", stopped=lambda: False)


def test_a_stop_request_ends_the_search_for_a_hub() -> None:
    assert connect("tcp/127.0.0.1:1", stopped=lambda: True) is None


def test_a_dead_screen_is_told_with_what_else_to_try(monkeypatch: pytest.MonkeyPatch) -> None:
    # However long it takes a busy machine to find that out.
    monkeypatch.setattr("viewer.display.SETTLE", PATIENCE_SECONDS)
    monkeypatch.setenv("DISPLAY", ":987")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    views = "--view native, web, page, record"
    with pytest.raises(UserError, match=rf"window could not be opened.*{views}"):
        Display(new_recording("test"), "native", blueprint=LAYOUT, file=None)


def test_recording_without_a_folder_is_refused() -> None:
    with pytest.raises(UserError, match="--out DIR"):
        Display(new_recording("test"), "record", blueprint=LAYOUT, file=None)


def test_a_taken_port_is_not_chosen() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert free_port(port) != port


@pytest.mark.live
def test_a_watched_run_is_recorded_and_ends_within_two_seconds_of_the_signal(
    robot: Robot, tmp_path: Path
) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    (tmp_path / "config.toml").write_text(dump_config(RunConfig(), versions={}))
    hub = ZenohBus(listen=[endpoint], mode="router")
    ticks = hub.publisher(TICKS_KEY.format(robot=robot.name), wait_when_full=True)
    link = hub.publisher(LINK_KEY, wait_when_full=True)
    steps = hub.publisher(STEPS_KEY.format(robot=robot.name), wait_when_full=True)
    viewer = Process(
        *("viewer", "live", "--config", str(tmp_path / "config.toml")),
        *("--telemetry", endpoint, "--view", "web", "--out", str(tmp_path)),
        env={**os.environ, "XDG_CACHE_HOME": str(tmp_path / "cache")},
    )
    try:
        began = time.monotonic()
        assert viewer.wait_for("READY") == "READY in a browser, at the address below"
        assert viewer.wait_for("http").endswith("%2Fproxy"), "the address is alone on its line"
        heard = (ticks, link, steps)
        until(lambda: all(map(is_heard, heard)), "the viewer does not subscribe")
        loaded = time.monotonic() - began
        for k in range(5):
            ticks.publish(encode_rows(*tick_rows(robot, 100, start=100 * k)))
            link.publish(encode_rows(*link_rows(100, start=100 * k)))
        steps.publish(encode_rows(*step_rows()))
        ticks.publish(b"not a block")
        viewer.wait_for("a block cannot be drawn")
        signalled = time.monotonic()
        viewer.signal(signal.SIGTERM)
        assert viewer.wait() == 0
        # Or on a machine on which everything takes long, sooner than it began.
        assert time.monotonic() - signalled < max(2.0, loaded)
    finally:
        viewer.end()
        hub.close()
    assert "0 blocks dropped when behind, 1 blocks refused" in viewer.output
    times, _ = logged(tmp_path / "recording.rrd", "/world/joints", "Transform3D:translation")
    np.testing.assert_array_equal(np.unique(times), np.arange(25) * 20_000_000)
    times, _ = logged(tmp_path / "recording.rrd", "/world/planned_soles", "LineStrips3D:strips")
    np.testing.assert_array_equal(times, np.arange(6) * 20_000_000)
