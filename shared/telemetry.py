"""Rows of measurements, from a real-time loop to a file, a live view and statistics.

A loop fills one row of numbers per tick, message or solve into a block; a full block is handed to a
background thread, which appends it to a file and publishes it. Nothing grows in the loop, nothing
blocks it. Afterwards the file becomes a Parquet table. Under lockstep there is no file: the blocks
stay in memory.
"""

from __future__ import annotations

import contextlib
import enum
import queue
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import msgpack
import numpy as np

if TYPE_CHECKING:
    import pyarrow as pa

BLOCK_ROWS = 100


class Source(enum.IntEnum):
    """Where a command came from.

    This tick's answer, an older one as it is, nowhere (the joints are held), the robot's own
    computer, an older answer corrected, or the same while the robot ends its walk.
    """

    FRESH = 0
    CACHED = 1
    HELD = 2
    ON_BOARD = 3
    CORRECTED = 4
    STOPPING = 5

    @property
    def label(self) -> str:
        """Its name in summaries, in the terminal and in the view."""
        return self.name.lower()


@dataclass(frozen=True)
class Column:
    """One column: a scalar (`width` 1) or a fixed-size vector; `kind` is its Parquet type."""

    name: str
    width: int = 1
    kind: str = "float64"


class Schema:
    """Columns laid side by side in rows of float64; `slices[name]` finds one."""

    def __init__(self, *columns: Column) -> None:
        self.columns = columns
        self.slices: dict[str, slice] = {}
        start = 0
        for column in columns:
            self.slices[column.name] = slice(start, start + column.width)
            start += column.width
        self.width = start

    def column(self, rows: np.ndarray, name: str) -> np.ndarray:
        """Values of a column: (n,) for a scalar, (n, width) for a vector."""
        values = rows[:, self.slices[name]]
        return values[:, 0] if values.shape[1] == 1 else values


# One row per tick of the robot. Times in ns: `time_ns` of the task (negative while waiting for the
# edge), `wall_ns` of the robot's clock. `source` is a `Source`.
# `q`, `v` true state, Pinocchio order; `f` commanded forces at the four points of both soles, zero
# where unloaded [N].
# `foot_slip_m` of the left and right foot since it was loaded, NaN in the air. `active_set` and
# `projector_sequence` are those of the command's projector: its bit mask (`Projector.active_set`)
# and the tick whose state it came from; −1 if none. `on_board_qps`: QPs begun on board so far.
# `contraction`, `staleness_rad`: as in `robot_node.controllers.Decision`, NaN if not corrected.
def tick_schema(*, nq: int, nv: int) -> Schema:
    """Schema of a robot's telemetry."""
    return Schema(
        Column("tick", kind="int64"),
        Column("time_ns", kind="int64"),
        Column("wall_ns", kind="int64"),
        Column("source", kind="int8"),
        Column("mode", kind="int8"),
        Column("q", nq),
        Column("v", nv),
        Column("tau", nv - 6),
        Column("f", 24),
        Column("com", 3),
        Column("com_reference", 3),
        Column("com_error_m"),
        Column("contact_violation_m_s2"),
        Column("push_n", 3),
        Column("foot_slip_m", 2),
        Column("projector_age_ns", kind="int64"),
        Column("projector_sequence", kind="int64"),
        Column("active_set", kind="int64"),
        Column("on_board_qps", kind="int64"),
        Column("contraction"),
        Column("staleness_rad"),
        Column("tick_ns", kind="int64"),
        Column("late_ns", kind="int64"),
        Column("overruns", kind="int64"),
        Column("refused", kind="int64"),
    )


# One row per message through the shim. `direction` 0 up, 1 down; `achieved_ns` is −1 if dropped.
LINK_SCHEMA = Schema(
    Column("wall_ns", kind="int64"),
    Column("direction", kind="int8"),
    Column("sequence", kind="int64"),
    Column("bytes", kind="int64"),
    Column("nominal_ns", kind="int64"),
    Column("achieved_ns", kind="int64"),
)

# One row per state the edge worked on. `status` is the index in `shared.wbc.qp.QpStatus`;
# `active_set` as `Projector.active_set`, −1 without a solution.
SOLVE_SCHEMA = Schema(
    Column("wall_ns", kind="int64"),
    Column("state_sequence", kind="int64"),
    Column("solve_ns", kind="int64"),
    Column("status", kind="int8"),
    Column("iterations", kind="int64"),
    Column("active_set", kind="int64"),
)


class RowLog:
    """Rows under one schema. `row()` gives the next row to fill; `close()` ends the log.

    With a `path`, blocks go to `path` as raw float64 and memory stays bounded; without, they are
    kept. `publish` receives each block's encoding on the background thread. A file takes `at_most`
    so many rows; those after them are published only. So are those that cannot be written, for
    which `failure` says why.
    """

    def __init__(
        self,
        schema: Schema,
        *,
        path: Path | None = None,
        publish: Callable[[bytes], None] | None = None,
        at_most: int | None = None,
    ) -> None:
        self.schema = schema
        self.path = path
        self.failure: OSError | None = None
        self._publish = publish
        self._left = at_most
        self._kept: list[np.ndarray] = []
        self._block = np.zeros((BLOCK_ROWS, schema.width))
        self._used = 0
        self._queue: queue.SimpleQueue[np.ndarray | None] = queue.SimpleQueue()
        self._file = path.open("wb") if path is not None else None
        self._thread: threading.Thread | None = None
        if self._file is not None or publish is not None:
            self._thread = threading.Thread(target=self._drain, name="row-log", daemon=True)
            self._thread.start()

    def row(self) -> np.ndarray:
        """The next row, shape (schema.width,), zeroed; fill it before the next call."""
        if self._used == BLOCK_ROWS:
            self._hand_over()
        self._used += 1
        return self._block[self._used - 1]

    def close(self) -> None:
        """Hand over the last rows and wait until they are written."""
        self._hand_over()
        if self._thread is not None:
            self._queue.put(None)
            self._thread.join(timeout=10.0)
            self._thread = None
        if self._file is not None:
            with contextlib.suppress(OSError):  # again what `failure` has
                self._file.close()
            self._file = None

    def rows(self) -> np.ndarray:
        """All rows of a closed log, shape (n, schema.width); memory-mapped when on file."""
        if self.path is None:
            return np.concatenate(self._kept) if self._kept else np.zeros((0, self.schema.width))
        width = self.schema.width
        count = self.path.stat().st_size // (width * np.dtype(np.float64).itemsize)
        if count == 0:
            return np.zeros((0, width))
        return np.memmap(self.path, dtype=np.float64, mode="r", shape=(count, width))

    def _hand_over(self) -> None:
        block, self._block = self._block[: self._used], np.zeros_like(self._block)
        self._used = 0
        if not len(block):
            return
        if self.path is None:
            self._kept.append(block)
        if self._thread is not None:
            self._queue.put(block)

    def _drain(self) -> None:
        while (block := self._queue.get()) is not None:
            if self._file is not None and self.failure is None:
                kept = block[: self._left]
                try:
                    self._file.write(kept.data)
                    self._file.flush()
                except OSError as error:
                    self.failure = error
                if self._left is not None:
                    self._left -= len(kept)
            if self._publish is not None:
                self._publish(encode_rows(self.schema, block))


def encode_rows(schema: Schema, rows: np.ndarray) -> bytes:
    """A block of rows with its schema, for the telemetry session."""
    columns = [(column.name, column.width, column.kind) for column in schema.columns]
    return bytes(msgpack.packb({"columns": columns, "rows": rows.tobytes()}))


def decode_rows(data: bytes) -> tuple[Schema, np.ndarray]:
    """Schema and rows (n, width) of a telemetry block; `ValueError` if it is not one."""
    try:
        block = msgpack.unpackb(data)
        schema = Schema(*(Column(*column) for column in block["columns"]))
        rows = np.frombuffer(block["rows"], dtype=np.float64).reshape(-1, schema.width)
    except (msgpack.UnpackException, KeyError, TypeError, ValueError) as error:
        raise ValueError(f"not a telemetry block: {error}") from None
    return schema, rows


def row_chunks(rows: np.ndarray, *, size: int = 20_000) -> Iterator[np.ndarray]:
    """Rows in chunks of bounded size."""
    for start in range(0, len(rows), size):
        yield rows[start : start + size]


def write_parquet(schema: Schema, rows: np.ndarray, path: Path) -> None:
    """Rows as a Parquet table, one column per schema column; vectors are fixed-size lists."""
    # Imported here: the control loops that only fill rows should not carry Arrow's memory.
    import pyarrow as pa
    import pyarrow.parquet as pq

    def field(column: Column) -> pa.DataType:
        kind = pa.from_numpy_dtype(np.dtype(column.kind))
        return kind if column.width == 1 else pa.list_(kind, column.width)

    arrow_schema = pa.schema([(column.name, field(column)) for column in schema.columns])
    with pq.ParquetWriter(path, arrow_schema, compression="zstd") as writer:
        for chunk in row_chunks(rows):
            arrays = []
            for column in schema.columns:
                values = np.ascontiguousarray(chunk[:, schema.slices[column.name]])
                flat = pa.array(values.astype(column.kind).ravel())
                arrays.append(
                    flat
                    if column.width == 1
                    else pa.FixedSizeListArray.from_arrays(flat, column.width)
                )
            writer.write_table(pa.table(arrays, schema=arrow_schema))


def read_parquet(path: Path, *, columns: Sequence[str] | None = None) -> tuple[Schema, np.ndarray]:
    """Schema and rows of a table that `write_parquet` wrote, or of some of its columns."""
    import pyarrow.parquet as pq

    table = pq.read_table(path, columns=None if columns is None else list(columns))
    return _schema_of(table.schema), _rows_of(table)


def parquet_shape(path: Path) -> tuple[Schema, int]:
    """Schema of such a table and its number of rows, which are not read."""
    import pyarrow.parquet as pq

    with pq.ParquetFile(path) as file:
        return _schema_of(file.schema_arrow), file.metadata.num_rows


def parquet_chunks(path: Path, *, size: int = 20_000) -> Iterator[tuple[Schema, np.ndarray]]:
    """Such a table in chunks of at most `size` rows, each with its schema."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    with pq.ParquetFile(path) as file:
        # One group after the other: over several, Arrow keeps all that it has read.
        for group in range(file.num_row_groups):
            for batch in file.iter_batches(batch_size=size, row_groups=[group]):
                yield _schema_of(batch.schema), _rows_of(pa.Table.from_batches([batch]))


def _schema_of(fields: pa.Schema) -> Schema:
    import pyarrow as pa

    columns = []
    for field in fields:
        width, kind = 1, field.type
        if pa.types.is_fixed_size_list(kind):
            width, kind = kind.list_size, kind.value_type
        columns.append(Column(field.name, width, str(kind).replace("double", "float64")))
    return Schema(*columns)


def _rows_of(table: pa.Table) -> np.ndarray:
    import pyarrow as pa

    parts = []
    for chunked in table.columns:
        array, width = chunked.combine_chunks(), 1
        if pa.types.is_fixed_size_list(array.type):
            width, array = array.type.list_size, array.flatten()
        parts.append(array.to_numpy(zero_copy_only=False).astype(np.float64).reshape(-1, width))
    return np.hstack(parts)
