"""Benchmarks that start processes: faults of a stack, messages over Zenoh, the peers."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import messages, peers
from benchmarks.faults.campaign import chosen, play_case
from benchmarks.faults.cases import LIVE, Case
from benchmarks.faults.promises import broken
from shared.errors import LinkError

pytestmark = pytest.mark.live


@pytest.mark.parametrize("case", chosen(0, short=True, kinds=[LIVE]), ids=lambda case: case.name)
def test_the_live_part_of_the_short_campaign_keeps_every_promise(case: Case) -> None:
    record = play_case(case)
    assert record["error"] is None
    outcome = record["summary"]
    if "skipped" in outcome:
        pytest.skip(outcome["skipped"])
    assert broken(case, outcome) == [], outcome


def test_messages_are_sent_and_received_by_the_bus_and_by_zenoh_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(messages, "MESSAGES", 50)
    for connect in (messages.ours, messages.bare):
        sent, received = messages.measure(connect)
        assert (len(sent), len(received)) == (50, 49)
        assert np.all(sent >= 0)
        assert np.all(received >= 0)


# It may install them first, which is nothing for a quick look.
def test_the_peers_take_a_step_at_the_same_states(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(peers, "header", lambda: "a machine")
    try:
        peers.environment()
    except LinkError as error:
        pytest.skip(str(error))
    lines = peers.run(rounds=1).splitlines()
    assert lines[1].startswith("peers: tsid 1.7.1, placo ")
    rows = lines[5 : 5 + len(peers.PEERS) + 5]
    assert [row[:22].strip() for row in rows] == [
        "PR robot tick", "LA robot tick", "LC robot tick", "edge step for LA",
        "edge: solution and A†", "tsid step", "placo step",
    ]  # fmt: skip
    tsid = next(line for line in lines if line.startswith("torques of tsid"))
    # The same problem but for the least normal force: equal where nothing is near its bound.
    assert float(tsid.split("at most ")[1].split()[0]) < 1.0
