from __future__ import annotations

import errno
import os
import shutil
import stat
import threading
import time

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shared.file_lock import is_locked
from shared.telemetry.parquet import parquet_chunks, parquet_shape, read_parquet, write_parquet
from shared.telemetry.row_log import (
    BLOCK_ROWS,
    RowLog,
    decode_rows,
    encode_rows,
    read_rows,
    row_chunks,
)
from shared.telemetry.schema import (
    LINK_SCHEMA,
    SOLVE_SCHEMA,
    STEP_SCHEMA,
    Column,
    Schema,
    tick_schema,
)
from tests.processes import until

SCHEMA = Schema(Column("tick", kind="int64"), Column("q", 3), Column("error"))
COUNTS = [0, 1, BLOCK_ROWS - 1, BLOCK_ROWS, BLOCK_ROWS + 1, 7 * BLOCK_ROWS + 3]


def fill(log, count, *, start=0):
    for k in range(start, start + count):
        row = log.row()
        row[0] = k
        row[1:4] = k + np.array([0.1, 0.2, 0.3])
    return log


def expected(count):
    rows = np.zeros((count, SCHEMA.width))
    rows[:, 0] = np.arange(count)
    rows[:, 1:4] = np.arange(count)[:, None] + np.array([0.1, 0.2, 0.3])
    return rows


def assert_same_schema(left, right):
    assert left.columns == right.columns
    assert left.width == right.width


def test_columns_lie_side_by_side():
    assert SCHEMA.width == 5
    assert SCHEMA.slices == {"tick": slice(0, 1), "q": slice(1, 4), "error": slice(4, 5)}


def test_a_scalar_column_is_flat_and_a_vector_is_not():
    rows = expected(4)
    assert SCHEMA.column(rows, "tick").tolist() == [0, 1, 2, 3]
    assert SCHEMA.column(rows, "q").shape == (4, 3)


def test_every_schema_names_its_columns_once():
    for schema in (tick_schema(nq=38, nv=37), LINK_SCHEMA, SOLVE_SCHEMA, STEP_SCHEMA):
        names = [column.name for column in schema.columns]
        assert len(set(names)) == len(names)
        assert schema.width == sum(column.width for column in schema.columns)


@pytest.mark.parametrize("count", COUNTS)
def test_a_log_in_memory_returns_every_row_in_order(count):
    log = fill(RowLog(SCHEMA), count)
    log.close()
    np.testing.assert_array_equal(log.rows(), expected(count))


@pytest.mark.parametrize("count", COUNTS)
def test_a_log_on_file_returns_every_row_in_order(tmp_path, count):
    log = fill(RowLog(SCHEMA, path=tmp_path / "ticks.f64"), count)
    log.close()
    np.testing.assert_array_equal(log.rows(), expected(count))
    schema, rows = read_rows(tmp_path / "ticks.f64")
    assert_same_schema(schema, SCHEMA)
    np.testing.assert_array_equal(rows, expected(count))


def test_a_new_row_is_empty_even_where_an_old_one_was():
    log = RowLog(SCHEMA)
    for _ in range(3 * BLOCK_ROWS):
        row = log.row()
        np.testing.assert_array_equal(row, 0.0)
        row[:] = 7.0
    log.close()
    assert len(log.rows()) == 3 * BLOCK_ROWS


def test_closing_twice_does_no_harm(tmp_path):
    for log in (RowLog(SCHEMA), RowLog(SCHEMA, path=tmp_path / "x")):
        fill(log, 5).close()
        log.close()
        assert len(log.rows()) == 5


def test_blocks_are_published_in_order_and_whole():
    received: list[bytes] = []
    log = RowLog(SCHEMA, publish=received.append)
    fill(log, 2 * BLOCK_ROWS + 7).close()
    blocks = [decode_rows(data, SCHEMA)[1] for data in received]
    assert [len(block) for block in blocks] == [BLOCK_ROWS, BLOCK_ROWS, 7]
    np.testing.assert_array_equal(np.vstack(blocks), expected(2 * BLOCK_ROWS + 7))


def test_rows_before_a_pause_are_published_before_their_block_is_full():
    received: list[bytes] = []
    log = RowLog(SCHEMA, publish=received.append)
    log.row()[:] = 1.0
    log.row()[:] = 2.0
    log.hand_over()
    until(lambda: len(received) == 1, "they are not published")
    # Without new rows there is nothing to hand over.
    log.hand_over()
    log.row()[:] = 3.0
    log.close()
    blocks = [decode_rows(data, SCHEMA)[1][:, 0].tolist() for data in received]
    assert blocks == [[1.0, 2.0], [3.0]]


@pytest.mark.parametrize("on_file", [False, True])
def test_columns_that_follow_from_others_are_completed_once_in_every_row(tmp_path, on_file):
    def complete(rows: np.ndarray) -> None:
        rows[:, -1] += rows[:, 0]

    published: list[bytes] = []
    path = tmp_path / "rows" if on_file else None
    publish = published.append if on_file else None
    log = fill(RowLog(SCHEMA, path=path, publish=publish, complete=complete), BLOCK_ROWS + 7)
    log.close()
    right = expected(BLOCK_ROWS + 7)
    right[:, -1] += right[:, 0]
    np.testing.assert_array_equal(log.rows(), right)
    if on_file:
        blocks = [decode_rows(data, SCHEMA)[1] for data in published]
        np.testing.assert_array_equal(np.vstack(blocks), right)


def test_filling_rows_does_not_wait_for_whoever_is_published_to():
    released = threading.Event()

    def publish(data: bytes) -> None:
        released.wait(120.0)

    log = RowLog(SCHEMA, publish=publish)
    started = time.monotonic()
    fill(log, 5 * BLOCK_ROWS)
    # The subscriber sleeps for 120 s; rows take microseconds.
    assert time.monotonic() - started < 60.0
    released.set()
    log.close()


@given(
    widths=st.lists(st.integers(1, 5), min_size=1, max_size=6),
    count=st.integers(1, 20),
    seed=st.integers(0, 99),
)
def test_blocks_arrive_to_the_last_bit_with_their_schema(widths, count, seed):
    schema = Schema(*(Column(f"c{k}", width) for k, width in enumerate(widths)))
    rows = np.random.default_rng(seed).standard_normal((count, schema.width))
    arrived, values = decode_rows(encode_rows(schema, rows), SCHEMA, schema)
    assert_same_schema(arrived, schema)
    np.testing.assert_array_equal(values, rows)


@settings(max_examples=200)
@given(data=st.binary(max_size=100))
def test_garbage_is_no_telemetry_block(data):
    with pytest.raises(ValueError, match="not a telemetry block"):
        decode_rows(data, SCHEMA)


@pytest.mark.parametrize(
    "block",
    [
        7,
        [],
        {},
        {"columns": []},
        {"columns": [], "rows": b""},
        {"columns": [["a"]], "rows": b"123"},
        {"columns": [["a", 2]], "rows": bytes(8)},
        {"columns": [["a", "wide"]], "rows": bytes(8)},
        {"columns": [["a", 0]], "rows": bytes(8)},
        {"columns": [["a", 2**63]], "rows": bytes(8)},
        {"columns": [["a", 1, "float64", "more"]], "rows": bytes(8)},
        {"columns": [[[], 1]], "rows": bytes(8)},
        {"columns": [["a"]], "rows": "text"},
        {"columns": 3, "rows": bytes(8)},
        {"columns": [["a", 1, "float64"]], "rows": b""},
        {"columns": [["b", 1, "float64"]], "rows": bytes(8)},
    ],
    ids=str,
)
def test_a_block_of_another_shape_is_refused(block):
    with pytest.raises(ValueError, match="not a telemetry block"):
        decode_rows(msgpack.packb(block), Schema(Column("a")))


@pytest.mark.parametrize(
    "data",
    [b"", b"garbage", b"7\n", b"[]\n", b'[["a", 0]]\n', b'[["a", "b"]]\n', b"[[1, 2", b"\xff\n"],
)
def test_another_file_is_not_one_of_rows(tmp_path, data):
    (tmp_path / "x").write_bytes(data)
    with pytest.raises(ValueError, match="expected the rows of a run"):
        read_rows(tmp_path / "x")


def test_rows_give_way_to_other_files(tmp_path):
    log = fill(RowLog(SCHEMA, path=tmp_path / "x"), 50)
    log.close()
    log.give_way(8 * SCHEMA.width * 20)
    np.testing.assert_array_equal(log.rows(), expected(30))
    log.give_way(10**6)
    assert len(log.rows()) == 0


def test_an_error_of_a_watcher_does_not_end_the_file(tmp_path):
    def publish(data: bytes) -> None:
        raise RuntimeError("the session is closed")

    log = fill(RowLog(SCHEMA, path=tmp_path / "x", publish=publish), 3 * BLOCK_ROWS)
    log.close()
    np.testing.assert_array_equal(log.rows(), expected(3 * BLOCK_ROWS))


def test_a_file_is_locked_while_its_rows_are_written(tmp_path):
    log = RowLog(SCHEMA, path=tmp_path / "x")
    assert is_locked(tmp_path / "x")
    # Another user who could read it could hold its lock.
    assert stat.S_IMODE((tmp_path / "x").stat().st_mode) == 0o600
    log.close()
    assert not is_locked(tmp_path / "x")


def test_chunks_are_bounded_and_leave_nothing_out():
    rows = expected(25)
    chunks = list(row_chunks(rows, size=10))
    assert [len(chunk) for chunk in chunks] == [10, 10, 5]
    np.testing.assert_array_equal(np.vstack(chunks), rows)


def test_parquet_keeps_values_types_and_widths(tmp_path, rng):
    schema = Schema(
        Column("tick", kind="int64"),
        Column("source", kind="int8"),
        Column("q", 3),
        Column("error"),
    )
    rows = rng.standard_normal((50, schema.width))
    rows[:, 0], rows[:, 1] = np.arange(50) + 2**50, np.arange(50) % 3
    rows[7, 5] = np.nan
    path = tmp_path / "ticks.parquet"
    write_parquet(schema, rows, path)
    back, values = read_parquet(path)
    assert_same_schema(back, schema)
    np.testing.assert_array_equal(values, rows)


@pytest.mark.parametrize("count", [0, 1, 20_001])
def test_parquet_tables_of_any_length(tmp_path, count):
    path = tmp_path / "ticks.parquet"
    write_parquet(SCHEMA, expected(count), path)
    back, values = read_parquet(path)
    assert_same_schema(back, SCHEMA)
    np.testing.assert_array_equal(values, expected(count))


def test_the_robots_rows_survive_parquet(tmp_path, rng):
    schema = tick_schema(nq=38, nv=37)
    rows = rng.integers(-100, 100, size=(10, schema.width)).astype(float)
    write_parquet(schema, rows, tmp_path / "ticks.parquet")
    back, values = read_parquet(tmp_path / "ticks.parquet")
    assert_same_schema(back, schema)
    np.testing.assert_array_equal(values, rows)


@pytest.mark.parametrize("at_most", [0, 3, BLOCK_ROWS, BLOCK_ROWS + 3])
def test_a_file_that_is_full_takes_no_more_rows_and_watchers_see_them_all(tmp_path, at_most):
    received: list[bytes] = []
    count = 2 * BLOCK_ROWS + 7
    log = RowLog(SCHEMA, path=tmp_path / "x", publish=received.append, at_most=at_most)
    fill(log, count).close()
    np.testing.assert_array_equal(log.rows(), expected(count)[:at_most])
    blocks = [decode_rows(data, SCHEMA)[1] for data in received]
    np.testing.assert_array_equal(np.vstack(blocks), expected(count))


def test_rows_that_cannot_be_written_are_watched_and_the_reason_is_kept(tmp_path):
    (tmp_path / "x").symlink_to("/dev/full")
    received: list[bytes] = []
    log = RowLog(SCHEMA, path=tmp_path / "x", publish=received.append)
    fill(log, 2 * BLOCK_ROWS + 7).close()
    assert log.failure is not None
    assert log.failure.errno == errno.ENOSPC
    assert len(log.rows()) == 0
    assert sum(len(decode_rows(data, SCHEMA)[1]) for data in received) == 2 * BLOCK_ROWS + 7


def test_a_row_that_was_written_in_part_is_none(tmp_path):
    log = fill(RowLog(SCHEMA, path=tmp_path / "x"), 5)
    log.close()
    os.truncate(tmp_path / "x", (tmp_path / "x").stat().st_size - 2 * 8 * SCHEMA.width + 1)
    np.testing.assert_array_equal(log.rows(), expected(3))


def test_some_columns_of_a_table_are_read_without_the_others(tmp_path):
    rows = np.arange(12.0).reshape(2, 6)
    schema = Schema(Column("a"), Column("b", 4), Column("c", kind="int64"))
    write_parquet(schema, rows, tmp_path / "x.parquet")
    some, values = read_parquet(tmp_path / "x.parquet", columns=["c", "b"])
    assert_same_schema(some, Schema(Column("c", kind="int64"), Column("b", 4)))
    np.testing.assert_array_equal(values, rows[:, [5, 1, 2, 3, 4]])


def test_a_table_is_read_in_bounded_chunks_of_the_same_rows(tmp_path):
    rows = expected(25_000)
    path = tmp_path / "rows.parquet"
    write_parquet(SCHEMA, rows, path)
    schema, count = parquet_shape(path)
    assert_same_schema(schema, SCHEMA)
    assert count == 25_000
    schemas, chunks = zip(*parquet_chunks(path, size=7_000), strict=True)
    assert max(len(chunk) for chunk in chunks) <= 7_000
    np.testing.assert_array_equal(np.vstack(chunks), rows)
    for each in schemas:
        assert_same_schema(each, SCHEMA)


def test_an_empty_table_has_a_shape_and_no_chunks(tmp_path):
    write_parquet(SCHEMA, expected(0), tmp_path / "rows.parquet")
    schema, count = parquet_shape(tmp_path / "rows.parquet")
    assert_same_schema(schema, SCHEMA)
    assert count == 0
    assert list(parquet_chunks(tmp_path / "rows.parquet")) == []


@pytest.mark.parametrize("when", ["before the end", "with its folder"])
def test_the_rows_of_a_file_that_was_removed_are_not_lost(tmp_path, when):
    folder = tmp_path / "run"
    folder.mkdir()
    log = fill(RowLog(SCHEMA, path=folder / "x"), BLOCK_ROWS + 5)
    if when == "before the end":
        (folder / "x").unlink()
    else:
        shutil.rmtree(folder)
    log.close()
    np.testing.assert_array_equal(log.rows(), expected(BLOCK_ROWS + 5))
