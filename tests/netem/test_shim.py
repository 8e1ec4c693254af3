"""The shim in one process: nothing early, nothing swapped, whatever arrives while it waits."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from netem.networks import constant_profile
from netem.profile import DOWNLINK, LOST, UPLINK, DelayProfile
from netem.shim import Shim, Sides
from shared.bus.base import Delivery, Envelope
from shared.clock import ScaledClock
from shared.config.link_settings import LinkConfig
from shared.errors import LinkError
from shared.telemetry.row_log import RowLog
from shared.telemetry.schema import LINK_SCHEMA
from shared.wire.operator.commands import Cut, ReplaceProfile, Restore
from tests.processes import PATIENCE_SECONDS, until

MS = 1_000_000
CLOCK = 7


class Outlet:
    """Notes what is forwarded and when, and its direction in a list shared with the other."""

    def __init__(self, direction: int, turns: list[int]) -> None:
        self.sent = 0
        self._direction = direction
        self._turns = turns
        self.forwarded: list[tuple[int, int]] = []

    def publish(self, data: bytes) -> None:
        raise NotImplementedError

    def forward(self, delivery: Delivery) -> None:
        assert delivery.envelope is not None
        self.forwarded.append((delivery.envelope.sequence, time.monotonic_ns()))
        self._turns.append(self._direction)
        self.sent += 1

    def wait_for(self, count: int) -> list[tuple[int, int]]:
        until(lambda: len(self.forwarded) >= count, lambda: f"{self.forwarded}")
        assert len(self.forwarded) == count
        return self.forwarded


class Bench:
    """A shim at work between two outlets."""

    def __init__(
        self,
        profile: DelayProfile,
        *,
        seed: int = 0,
        keep_order: bool = True,
        clock: int = CLOCK,
    ) -> None:
        self.log = RowLog(LINK_SCHEMA)
        self.noted = 0
        self.turns: list[int] = []
        self.message: list[str] = []
        self.outlets = (Outlet(UPLINK, self.turns), Outlet(DOWNLINK, self.turns))
        self.shim = Shim(
            profile,
            LinkConfig(keep_order=keep_order),
            seed=seed,
            sides=Sides(*self.outlets, plans=self.outlets[DOWNLINK]),
            row=self._row,
            clock=clock,
            say=self.message.append,
        )

    def _row(self) -> np.ndarray:
        self.noted += 1
        return self.log.row()

    def send(self, direction: int, sequence: int, *, sent_ns: int, clock: int = CLOCK) -> None:
        envelope = Envelope(1, sequence, sent_ns, clock)
        self.shim.receive(direction)(Delivery(b"x", envelope))

    @contextmanager
    def running(self) -> Iterator[None]:
        done = threading.Event()
        thread = threading.Thread(target=self.shim.run, args=(done.is_set,))
        thread.start()
        try:
            yield
        finally:
            done.set()
            thread.join()

    def column(self, name: str) -> np.ndarray:
        self.log.close()
        return LINK_SCHEMA.column(self.log.rows(), name)


@pytest.mark.parametrize("direction", [UPLINK, DOWNLINK])
def test_each_message_leaves_in_order_and_not_before_its_delay(direction: int) -> None:
    bench = Bench(constant_profile("constant:10ms/15ms"))
    sent = []
    with bench.running():
        for k in range(30):
            sent.append(time.monotonic_ns())
            bench.send(direction, k, sent_ns=sent[-1])
            time.sleep(0.001)
        forwarded = bench.outlets[direction].wait_for(30)
    assert [sequence for sequence, _ in forwarded] == list(range(30))
    delay_ns = (10 * MS, 15 * MS)[direction]
    assert all(left - sent[k] >= delay_ns for k, left in forwarded)
    assert bench.outlets[1 - direction].sent == 0


def test_the_log_has_the_delay_that_each_message_had() -> None:
    bench = Bench(constant_profile("constant:10ms/15ms"))
    with bench.running():
        for k in range(5):
            bench.send(UPLINK, k, sent_ns=time.monotonic_ns())
            bench.send(DOWNLINK, k, sent_ns=time.monotonic_ns())
        for outlet in bench.outlets:
            outlet.wait_for(5)
    nominal, way = bench.column("nominal_ns"), bench.column("direction")
    assert np.array_equal(nominal, np.where(way == UPLINK, 10 * MS, 15 * MS))
    assert np.all(bench.column("achieved_ns") >= nominal)


def test_a_message_due_before_the_one_waited_for_does_not_wait_with_it() -> None:
    profile = DelayProfile("falling", np.array([[3_600_000 * MS, MS]] * 2))
    from_its_beginning = next(seed for seed in range(100) if profile.start_offset_ns(seed) == 0)
    bench = Bench(profile, seed=from_its_beginning, keep_order=False)
    start_ns = time.monotonic_ns()
    with bench.running():
        bench.send(UPLINK, 0, sent_ns=start_ns)
        # Longer than the thread sleeps when it has nothing to wait for.
        time.sleep(0.15)
        bench.send(UPLINK, 1, sent_ns=start_ns + MS)
        ((first, left_ns),) = bench.outlets[UPLINK].wait_for(1)
    assert first == 1
    assert left_ns < start_ns + 3_600_000 * MS


def test_a_message_that_came_late_leaves_at_once_and_keeps_its_place() -> None:
    bench = Bench(constant_profile("constant:2ms/2ms"))
    now_ns = time.monotonic_ns()
    with bench.running():
        for k in range(3):
            bench.send(UPLINK, k, sent_ns=now_ns - 50 * MS + k)
        forwarded = bench.outlets[UPLINK].wait_for(3)
    assert [sequence for sequence, _ in forwarded] == [0, 1, 2]
    assert np.all(bench.column("achieved_ns") >= 50 * MS)


def test_the_stamp_of_another_machines_clock_is_not_believed() -> None:
    bench = Bench(constant_profile("constant:10ms/10ms"))
    arrived_ns = time.monotonic_ns()
    with bench.running():
        bench.send(UPLINK, 0, sent_ns=0, clock=CLOCK + 1)
        ((_, left_ns),) = bench.outlets[UPLINK].wait_for(1)
    assert left_ns - arrived_ns >= 10 * MS


def test_where_no_clock_has_a_name_no_stamp_is_believed() -> None:
    bench = Bench(constant_profile("constant:10ms/10ms"), clock=0)
    arrived_ns = time.monotonic_ns()
    with bench.running():
        bench.send(UPLINK, 0, sent_ns=0, clock=0)
        ((_, left_ns),) = bench.outlets[UPLINK].wait_for(1)
    assert left_ns - arrived_ns >= 10 * MS


def test_a_stamp_of_the_future_holds_nothing_up() -> None:
    bench = Bench(constant_profile("constant:1ms/1ms"))
    with bench.running():
        bench.send(UPLINK, 0, sent_ns=time.monotonic_ns() + 3600 * 1000 * MS)
        bench.send(UPLINK, 1, sent_ns=time.monotonic_ns())
        forwarded = bench.outlets[UPLINK].wait_for(2)
    assert [sequence for sequence, _ in forwarded] == [0, 1]


def test_a_burst_one_way_does_not_hold_the_other_back() -> None:
    bench = Bench(constant_profile("constant:1ms/1ms"))
    long_ago_ns = time.monotonic_ns() - 50 * MS
    for k in range(300):
        bench.send(UPLINK, k, sent_ns=long_ago_ns)
    bench.send(DOWNLINK, 0, sent_ns=long_ago_ns)
    with bench.running():
        bench.outlets[UPLINK].wait_for(300)
    # A few of the other's at most before it.
    assert bench.turns.index(DOWNLINK) < 10


def test_it_can_be_stopped_in_the_middle_of_a_long_delay() -> None:
    bench = Bench(constant_profile("constant:60s/60s"))
    stopping = threading.Event()
    thread = threading.Thread(target=bench.shim.run, args=(stopping.is_set,), daemon=True)
    bench.send(UPLINK, 0, sent_ns=time.monotonic_ns())
    thread.start()
    # It sleeps until its message is due.
    time.sleep(0.2)
    stopping.set()
    thread.join(timeout=PATIENCE_SECONDS)
    assert not thread.is_alive()
    assert bench.shim.under_way == 1


def test_what_is_under_way_is_bounded_and_said_to_be(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("netem.shim._MAX_BYTES", 3)
    bench = Bench(constant_profile("constant:50ms/50ms"))
    now_ns = time.monotonic_ns()
    # A byte each.
    for k in range(5):
        bench.send(k % 2, k, sent_ns=now_ns)
    with bench.running():
        bench.outlets[UPLINK].wait_for(2)
        bench.outlets[DOWNLINK].wait_for(1)
        # There is room again once they have left and are noted down.
        until(lambda: bench.noted == 5, "what has left is not noted down")
        bench.send(UPLINK, 5, sent_ns=time.monotonic_ns())
        bench.outlets[UPLINK].wait_for(3)
    assert sum("without room are lost" in line for line in bench.message) == 1
    sequence, achieved = bench.column("sequence"), bench.column("achieved_ns")
    assert set(sequence[achieved == -1]) == {3, 4}


def test_what_the_profile_loses_is_logged_and_not_forwarded() -> None:
    bench = Bench(DelayProfile("lossy", np.array([[LOST], [MS]])))
    with bench.running():
        bench.send(UPLINK, 0, sent_ns=time.monotonic_ns())
        bench.send(DOWNLINK, 0, sent_ns=time.monotonic_ns())
        bench.outlets[DOWNLINK].wait_for(1)
    assert bench.outlets[UPLINK].sent == 0
    achieved, way = bench.column("achieved_ns"), bench.column("direction")
    assert np.all(achieved[way == UPLINK] == -1)
    assert np.all(achieved[way == DOWNLINK] >= MS)


def test_delays_scale_with_simulated_time_and_stand_still_with_it() -> None:
    bench = Bench(constant_profile("constant:20ms/20ms"))
    with bench.running():
        bench.send(UPLINK, 0, sent_ns=time.monotonic_ns())
        bench.outlets[UPLINK].wait_for(1)
        clock = ScaledClock()
        clock.run_at(0.25)
        bench.shim.set_time(clock.origin)
        begun_ns = time.monotonic_ns()
        bench.send(UPLINK, 1, sent_ns=begun_ns)
        (_, left_ns) = bench.outlets[UPLINK].wait_for(2)[1]
        assert left_ns - begun_ns >= 80 * MS
        clock.run_at(0.0)
        bench.shim.set_time(clock.origin)
        bench.send(UPLINK, 2, sent_ns=time.monotonic_ns())
        resumed_ns = time.monotonic_ns()
        clock.run_at(1.0)
        bench.shim.set_time(clock.origin)
        (_, left_ns) = bench.outlets[UPLINK].wait_for(3)[2]
        # The whole delay is still to come after the pause.
        assert left_ns - resumed_ns >= 20 * MS
    # In the robot's time each message had the delay of the profile.
    assert list(bench.column("nominal_ns")) == [20 * MS] * 3
    assert np.all(bench.column("achieved_ns") >= 20 * MS)


def test_a_command_holds_for_the_messages_sent_after_it() -> None:
    bench = Bench(constant_profile("constant:2ms/2ms"))
    with pytest.raises(LinkError, match="no message has come to the link yet"):
        bench.shim.change(Cut(), None)
    with bench.running():
        bench.send(UPLINK, 0, sent_ns=time.monotonic_ns())
        bench.outlets[UPLINK].wait_for(1)
        bench.shim.change(Cut(), None)
        bench.send(UPLINK, 1, sent_ns=time.monotonic_ns())
        bench.send(DOWNLINK, 0, sent_ns=time.monotonic_ns())
        bench.shim.change(Restore(), None)
        bench.shim.change(ReplaceProfile("x"), constant_profile("constant:4ms/6ms"))
        bench.send(UPLINK, 2, sent_ns=time.monotonic_ns())
        bench.send(DOWNLINK, 1, sent_ns=time.monotonic_ns())
        assert [number for number, _ in bench.outlets[UPLINK].wait_for(2)] == [0, 2]
        assert [number for number, _ in bench.outlets[DOWNLINK].wait_for(1)] == [1]
    assert sorted(bench.column("nominal_ns")) == [0, 0, 2 * MS, 4 * MS, 6 * MS]
