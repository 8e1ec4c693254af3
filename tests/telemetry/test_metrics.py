from __future__ import annotations

import numpy as np
import pytest

from shared.telemetry.metrics import (
    active_set_discrepancy,
    by_cardinality,
    in_task,
    mean,
    quantiles,
    stance_slips,
    switch_to_fresh_ms,
    ticks_by_cardinality,
    true_active_sets,
)
from shared.telemetry.schema import SOLVE_SCHEMA, tick_schema

SCHEMA = tick_schema(nq=38, nv=37)
MS = 1_000_000
NAN = np.nan


def ticks(n, **columns):
    """Rows of `n` ticks, 1 ms apart; columns by name."""
    rows = np.zeros((n, SCHEMA.width))
    values = {
        "tick": np.arange(n),
        "time_ns": np.arange(n) * MS,
        "projector_sequence": np.arange(n),
        **columns,
    }
    for name, value in values.items():
        rows[:, SCHEMA.slices[name]] = np.asarray(value, dtype=float).reshape(n, -1)
    return rows


def solves(**sets):
    """Rows of the edge: `s3=0b101` for the active set of state 3."""
    rows = np.zeros((len(sets), SOLVE_SCHEMA.width))
    for row, (name, value) in zip(rows, sets.items(), strict=True):
        row[SOLVE_SCHEMA.slices["state_sequence"]] = int(name[1:])
        row[SOLVE_SCHEMA.slices["active_set"]] = value
    return rows


def test_a_stance_counts_with_the_most_it_slid():
    left = [0.0, 0.001, 0.003, NAN, NAN, 0.0, 0.002]
    right = [NAN, NAN, 0.0, 0.0, 0.004, 0.001, NAN]
    rows = ticks(7, foot_slip_m=np.column_stack([left, right]))
    assert sorted(stance_slips(SCHEMA, rows)) == [0.002, 0.003, 0.004]
    assert stance_slips(SCHEMA, rows[:0]).size == 0


def test_a_switch_waits_for_a_projector_of_a_state_after_it():
    modes = [0] * 4 + [1] * 6 + [0] * 3
    # Two ticks old all along, but the last switch gets none of its own.
    sequence = [0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9]
    waits = switch_to_fresh_ms(SCHEMA, ticks(13, mode=modes, projector_sequence=sequence))
    np.testing.assert_array_equal(waits, [2.0, NAN])
    assert switch_to_fresh_ms(SCHEMA, ticks(5)).size == 0


def test_the_discrepancy_counts_the_rows_in_one_set_only():
    used = [0b0, 0b11, 0b1010, 1 << 39, -1, 0b1]
    rows = ticks(6, active_set=used)
    edge = solves(s3=0, s0=0, s2=0b0101, s1=0b01, s4=0)
    true_sets = true_active_sets(SCHEMA, rows, edge)
    np.testing.assert_array_equal(true_sets, [0, 0b01, 0b0101, 0, 0, -1])
    found = active_set_discrepancy(SCHEMA, rows, true_sets)
    np.testing.assert_array_equal(found, [0, 1, 4, 1, NAN, NAN])


@pytest.mark.parametrize("edge", [solves(), solves(s99=1)])
def test_without_the_true_set_there_is_no_discrepancy(edge):
    rows = ticks(3)
    true_sets = true_active_sets(SCHEMA, rows, edge)
    assert np.isnan(active_set_discrepancy(SCHEMA, rows, true_sets)).all()


def test_errors_are_averaged_over_the_ticks_of_each_cardinality():
    cardinality = np.array([0, 3, 0, NAN, 3, 1])
    values = np.array([1.0, 5.0, 2.0, 99.0, 7.0, NAN])
    assert ticks_by_cardinality(cardinality) == [2, 1, 0, 2]
    # Of the one tick at cardinality 1 the error is unknown; there is none at 2.
    assert by_cardinality(cardinality, values) == [1.5, None, None, 6.0]
    unknown = np.full(3, NAN)
    assert (ticks_by_cardinality(unknown), by_cardinality(unknown, unknown)) == ([], [])


def test_waiting_is_not_part_of_the_task():
    rows = ticks(5, time_ns=[-1, -1, 0, MS, 2 * MS])
    assert SCHEMA.column(in_task(SCHEMA, rows), "tick").tolist() == [2, 3, 4]
    assert len(in_task(SCHEMA, rows[:2])) == 0


def test_what_is_not_finite_does_not_count():
    values = np.array([1.0, NAN, 3.0])
    assert mean(values) == 2.0
    assert quantiles(values)["max"] == 3.0
    assert mean(values[1:2]) is None
    assert quantiles(values[1:2]) == {"p50": None, "p99": None, "max": None}
