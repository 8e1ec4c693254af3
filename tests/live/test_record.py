"""Recording a path between real processes on loopback: what holds however busy the machine is."""

from __future__ import annotations

import re
import signal
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from benchmarks.recording import same_periods
from netem.networks import load_profile
from netem.profile import LOST
from netem.recorder.probe import VERSION, version_notice
from shared.bus.zenoh_bus import ZenohBus
from shared.wire.channels import DOWNLINK, UPLINK
from tests.processes import PATIENCE_SECONDS, Process, descendants_naming, until

pytestmark = pytest.mark.live

Start = Callable[..., Process]
MS = 1e6
# `netem record` that gives up sooner than it does.
IMPATIENT = """
from netem.__main__ import main
from netem.recorder import record, record_loops
from shared.process.cli import run
record.CONNECT_SECONDS = record_loops.CONNECT_SECONDS = 3.0
run(main)
"""


def start_far(start: Start, endpoint: str) -> Process:
    far = start("netem", "record", "--listen", endpoint)
    far.wait_for("READY")
    return far


def record(start: Start, endpoint: str, out: Path, *, seconds: float) -> Process:
    near = start(
        *("netem", "record", "--connect", endpoint, "--out", str(out)),
        *("--seconds", str(seconds)),
    )
    assert near.wait() == 0, near.output
    return near


def record_through_shim(
    start: Start, endpoints: list[str], network: str, out: Path, *, seconds: float
) -> tuple[np.ndarray, np.ndarray]:
    """Record `network` as it is replayed: the delays replayed and those recorded in the same
    periods, shape (2, n) [ns].
    """
    edge_side, robot_side = endpoints
    folder = out.with_suffix("")
    far = start_far(start, edge_side)
    shim = start(
        *("netem", "replay", network, "--listen", robot_side, "--connect", edge_side),
        *("--out", str(folder)),
    )
    shim.wait_for("READY")
    record(start, robot_side, out, seconds=seconds)
    for process in (shim, far):
        process.signal(signal.SIGINT)
        assert process.wait() == 0, process.output
    return same_periods(network, out, folder / "link.parquet")


def test_a_recording_on_loopback_is_a_profile_that_replay_accepts(
    start: Start, endpoints: list[str], tmp_path: Path
) -> None:
    far = start_far(start, endpoints[0])
    out = tmp_path / "mylink.npz"
    near = record(start, endpoints[0], out, seconds=2.0)
    assert "both ends on one machine" in near.output
    profile = load_profile(str(out))
    assert profile.delays_ns.shape == (2, 2000)
    assert (profile.metadata["offset_ns"], profile.metadata["uncertainty_ns"]) == (0, 0)
    assert profile.metadata["refused"] == {}
    assert not profile.metadata["ended_early"]
    for delays in profile.delays_ns:
        assert np.mean(delays == LOST) < 0.05
        assert 0 < np.median(delays[delays != LOST]) < 20 * MS
    # The far end goes on: the next one records as well, in text.
    record(start, endpoints[0], tmp_path / "again.csv", seconds=0.5)
    assert load_profile(str(tmp_path / "again.csv")).delays_ns.shape == (2, 500)
    shim = start(
        *("netem", "replay", str(out), "--listen", endpoints[1], "--connect", endpoints[0])
    )
    shim.wait_for("READY")
    far.signal(signal.SIGINT)
    assert far.wait() == 0
    assert far.output.count(" messages a second") == 2
    assert descendants_naming(f"--out {tmp_path}") == []


def test_a_recorded_replay_has_no_delay_cut_short(
    start: Start, endpoints: list[str], tmp_path: Path
) -> None:
    network, out = "constant:8ms/14ms", tmp_path / "first.npz"
    for leg in range(2):
        _, recorded = record_through_shim(start, endpoints, network, out, seconds=1.0)
        for delays, least_ms in zip(recorded, (8, 14), strict=True):
            passed = delays[delays != LOST]
            # The recorder loses nothing of its own; a busy machine may.
            assert len(passed) > 0
            assert passed.min() >= least_ms * MS
        # What was recorded is replayed next.
        network, out = str(out), tmp_path / f"again{leg}.npz"


def test_an_outage_is_replayed_recorded_and_replayed_again(
    start: Start, endpoints: list[str], tmp_path: Path
) -> None:
    network, out = "factory/011", tmp_path / "first.npz"
    for leg in range(2):
        # Long enough to meet the outage where seed 0 starts it.
        replayed, recorded = record_through_shim(start, endpoints, network, out, seconds=3.0)
        assert replayed.max() > 150 * MS
        assert recorded.max() > 150 * MS
        network, out = str(out), tmp_path / f"again{leg}.npz"


def start_near(start: Start, endpoint: str, out: Path) -> Process:
    """A recording of an hour that has begun to measure, some half a second ago."""
    sent: list[bytes] = []
    beside = ZenohBus.dial(endpoint, within=PATIENCE_SECONDS)
    try:
        beside.subscribe(UPLINK.key_for("romeo"), lambda delivery: sent.append(delivery.data))
        near = start(
            *("netem", "record", "--connect", endpoint, "--out", str(out), "--seconds", "3600")
        )
        near.wait_for("recording 3600 s")
        # The first fifth of a second does not count.
        before = len(sent)
        until(lambda: len(sent) > before + 700, lambda: f"{len(sent)} sent:\n{near.output}")
    finally:
        beside.close()
    return near


def test_an_interrupted_recording_keeps_what_was_measured(
    start: Start, endpoints: list[str], tmp_path: Path
) -> None:
    start_far(start, endpoints[0])
    out = tmp_path / "mylink.npz"
    began = time.monotonic()
    near = start_near(start, endpoints[0], out)
    near.signal(signal.SIGINT)
    assert near.wait() == 0, near.output
    profile = load_profile(str(out))
    assert 100 < profile.delays_ns.shape[1] < 1000 * (time.monotonic() - began)
    assert profile.metadata["ended_early"]
    assert list(tmp_path.iterdir()) == [out]


def test_the_far_end_may_leave_in_the_middle(
    start: Start, endpoints: list[str], tmp_path: Path
) -> None:
    far = start_far(start, endpoints[0])
    out = tmp_path / "mylink.npz"
    near = start_near(start, endpoints[0], out)
    far.signal(signal.SIGINT)
    assert far.wait() == 0, far.output
    # The recording goes on: half a second of it is what is looked at below.
    time.sleep(0.6)
    near.signal(signal.SIGINT)
    assert near.wait() == 0, near.output
    assert "no message of the far end arrived" in near.output
    for delays in load_profile(str(out)).delays_ns:
        assert np.all(delays[-500:] == LOST)
        assert np.any(delays != LOST)


def test_nobody_and_somebody_who_does_not_answer_are_said_in_one_line(
    start: Start, endpoints: list[str], tmp_path: Path
) -> None:
    mute = ZenohBus(listen=[endpoints[1]])
    try:
        # Both wait for their three seconds at the same time.
        nobody, somebody = (
            start("-c", IMPATIENT, "record", "--connect", each, "--out", str(tmp_path / "x.npz"))
            for each in endpoints
        )
        for near in (nobody, somebody):
            assert near.wait() == 2, near.output
            assert len(near.lines) == 2, near.output
            assert "./wbc netem record --listen tcp/0.0.0.0:7460" in near.lines[-1]
    finally:
        mute.close()
    refused = f"error: no connection within 3 s: {endpoints[0]} refuses"
    assert nobody.lines[-1].startswith(refused)
    unanswered = f"error: expected an answer from {endpoints[1]} within 3 s"
    assert somebody.lines[-1].startswith(unanswered)
    assert list(tmp_path.iterdir()) == []


def test_a_far_end_of_another_version_is_named(
    start: Start, endpoints: list[str], tmp_path: Path
) -> None:
    bus = ZenohBus(listen=[endpoints[0]])
    try:
        publisher = bus.publisher(DOWNLINK.key_for("romeo"))
        near = start(
            *("netem", "record", "--connect", endpoints[0], "--out", str(tmp_path / "x.npz"))
        )
        near.wait_for("dialling")
        notice = version_notice()[:4] + (VERSION + 1).to_bytes(2, "little")

        def over() -> bool:
            publisher.publish(notice)
            return near.popen.poll() is not None

        until(over, lambda: near.output)
    finally:
        bus.close()
    assert near.wait() == 2
    assert re.search(r"error: .*another version.*expected 1, got 2", near.lines[-1])


def test_an_endpoint_that_is_none_is_said_in_one_line(start: Start, tmp_path: Path) -> None:
    near = start("netem", "record", "--connect", "there", "--out", str(tmp_path / "x.npz"))
    assert near.wait() == 2
    # After one that says what is dialled.
    assert len(near.lines) == 2
    assert "error: endpoint: expected PROTOCOL/HOST:PORT" in near.lines[-1]
    assert list(tmp_path.iterdir()) == []
