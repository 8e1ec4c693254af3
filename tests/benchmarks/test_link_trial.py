"""What the benchmark of the link counts, on arrivals made up."""

from __future__ import annotations

import numpy as np

from benchmarks.link_trial import LinkTrial, way_errors
from netem.profile import DOWNLINK, UPLINK
from shared.telemetry.schema import LINK_SCHEMA

MS = 1_000_000


def arrivals(rows: list[tuple[int, int, int]]) -> np.ndarray:
    """(sequence, sent, arrived) [ns] as `link_end` writes them."""
    return np.array([(*row, 0) for row in rows], dtype=np.int64).reshape(-1, 4)


def log(rows: list[tuple[int, int, int, int]]) -> np.ndarray:
    """(direction, sequence, nominal, achieved) [ns] as the shim does."""
    table = np.zeros((len(rows), LINK_SCHEMA.width))
    for row, values in zip(table, rows, strict=True):
        for name, value in zip(
            ("direction", "sequence", "nominal_ns", "achieved_ns"), values, strict=True
        ):
            row[LINK_SCHEMA.slices[name]] = value
    return table


def trial(down: np.ndarray, rows: np.ndarray | None = None) -> LinkTrial:
    empty = np.zeros((0, LINK_SCHEMA.width))
    return LinkTrial((arrivals([]), down), empty if rows is None else rows, 0.0, "")


def test_lost_early_and_swapped_messages_are_counted() -> None:
    down = arrivals(
        [
            (10, 0, 10 * MS),
            (12, 2 * MS, 12 * MS + 5),
            # 11 came after 12, and 13 never.
            (11, 1 * MS, 13 * MS),
            (14, 4 * MS, 14 * MS - 1),
        ]
    )
    way = way_errors(trial(down), DOWNLINK, one_way_ns=10 * MS)
    assert (way.messages, way.lost, way.early, way.swapped) == (4, 1, 1, 1)
    assert way.received_ns.tolist() == [0, 5, 2 * MS, -1]
    assert way.released_ns.size == 0


def test_each_message_is_compared_with_its_own_row_of_the_log() -> None:
    # So long after the machine was started that a float knows no single nanoseconds.
    sent_ns = 2**54 + 100
    down = arrivals([(4, sent_ns, sent_ns + 3 * MS), (6, sent_ns + 1, sent_ns + 1 + 9 * MS)])
    rows = log(
        [
            (DOWNLINK, 6, 8 * MS, 8 * MS + 2),
            (UPLINK, 4, 50 * MS, 60 * MS),
            (DOWNLINK, 4, 3 * MS - 7, 3 * MS - 6),
            # One that was lost behind the shim.
            (DOWNLINK, 5, 3 * MS, 3 * MS),
        ]
    )
    way = way_errors(trial(down, rows), DOWNLINK, one_way_ns=None)
    assert way.received_ns.tolist() == [7, MS]
    assert way.released_ns.tolist() == [1, 2]


def test_a_direction_without_messages_has_no_errors() -> None:
    way = way_errors(trial(arrivals([])), UPLINK, one_way_ns=0)
    assert (way.messages, way.lost, way.early, way.swapped) == (0, 0, 0, 0)
